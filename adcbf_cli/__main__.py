"""`python -m adcbf_cli` is `adcbf`."""

from adcbf_cli.app import main

main()
