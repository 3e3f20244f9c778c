# Everything a newcomer or a script needs. `make demo` and `make test` need Python >= 3.11, make and
# a network for packages, and nothing else.

VENV := .venv
BIN := $(VENV)/bin

.DELETE_ON_ERROR:
.PHONY: help demo test lint docs sample results bench clean

help: ## Show the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{ printf "%-10s %s\n", $$1, $$2 }'

$(BIN)/python:
	scripts/make_venv.sh $(VENV)

$(VENV)/.installed: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $@

demo: $(VENV)/.installed ## Run the whole pipeline on the sample log and score it
	$(BIN)/adcbf run sample_data/sample.mcap --output sample.adcbf --range 12 --truth sample_data/truth.csv

test: $(VENV)/.installed-dev ## Run the tests
	scripts/open3d_libraries.sh $(BIN)/python
	scripts/browser.sh
	$(BIN)/python -m pytest

lint: $(VENV)/.installed-dev ## Check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/.installed-dev ## Write the commands' pages and build the site, in build/docs
	$(BIN)/python scripts/command_pages.py
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs
	@echo "build/docs/index.html"

sample: $(VENV)/.installed ## Remake the sample log and its ground truth, byte for byte
	scripts/open3d_libraries.sh $(BIN)/python
	$(BIN)/python -m pip install --quiet zstandard==0.25.0  # other releases may compress into other bytes
	$(BIN)/adcbf simulate sample_data/scenario.yaml --output sample_data/sample.mcap --truth sample_data/truth.csv

bench: $(VENV)/.installed ## Measure speed and memory, beside a plain pipeline of the same libraries
	$(BIN)/python benchmarks

clean: ## Remove what the other targets made
	rm -rf $(VENV) sample.adcbf build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
