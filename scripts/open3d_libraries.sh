#!/bin/sh
# open3d's wheel wants three system libraries. Installs the missing ones where that is allowed (root,
# apt), and otherwise names the command; never fails, since all but the simulator works without.
# Usage: open3d_libraries.sh PYTHON
set -u

packages="libusb-1.0-0 libgl1 libgomp1"
if reason=$("$1" -c 'import open3d' 2>&1); then
    exit 0
fi
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    echo "installing open3d's system libraries: $packages"
    # shellcheck disable=SC2086
    apt-get update -qq && apt-get install -y -qq --no-install-recommends $packages && exit 0
fi
echo "open3d cannot be loaded ($(echo "$reason" | tail -n 1)); \`adcbf simulate\` and its tests need it." >&2
echo "Install its system libraries with: sudo apt-get install $packages" >&2
exit 0
