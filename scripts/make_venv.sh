#!/bin/sh
# Makes a virtual environment with the first Python >= 3.11 that can. Usage: make_venv.sh FOLDER
set -eu

suits() {
    command -v "$1" >/dev/null 2>&1 &&
        "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null
}

for python in "${PYTHON:-python3}" python3.13 python3.12 python3.11; do
    if suits "$python"; then
        if "$python" -c 'import ensurepip, venv' 2>/dev/null; then
            exec "$python" -m venv "$1"
        fi
        without_venv=$python
    fi
done

if [ -z "${without_venv:-}" ]; then
    echo "adcbf needs Python 3.11 or newer; name one with: make PYTHON=/path/to/python3" >&2
    exit 1
fi
version=$("$without_venv" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    apt-get update -qq && apt-get install -y -qq "python$version-venv"
    exec "$without_venv" -m venv "$1"
fi
echo "$without_venv lacks the venv module; install it with: sudo apt-get install python$version-venv" >&2
exit 1
