#!/usr/bin/env bash
# Installs the browser that the tests of the page drive, and its driver, from Debian. Does nothing when both are there.
set -euo pipefail

command -v chromium >/dev/null && command -v chromedriver >/dev/null && exit 0
if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
	echo "install-chromium: the tests of the page need 'chromium' and 'chromedriver' in PATH; on Debian:" >&2
	echo "  sudo apt-get install chromium chromium-driver" >&2
	exit 1
fi
apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium chromium-driver >/dev/null
