#!/usr/bin/env bash
# Puts axe-core, which checks the page for what keeps people out, at .tools/axe/axe.min.js: taken from a Python wheel
# that carries it, checked against its hash. Does nothing when it is there already. It is used by tests alone.
set -euo pipefail
cd "$(dirname "$0")/.."

version=0.1.8
sha256=fdd263c998388f1a8e67cad02677e612d946248bd44d163be5e8650ea31f95f8
target=.tools/axe/axe.min.js
[ "$(cat .tools/axe/version 2>/dev/null)" = "$version" ] && [ -f "$target" ] && exit 0

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m pip download --quiet --disable-pip-version-check --no-deps -d "$work" "axe-playwright-python==$version"
wheel=$(echo "$work"/*.whl)
echo "$sha256  $wheel" | sha256sum --check --quiet || {
	echo "fetch-axe: $wheel is not the expected file" >&2
	exit 1
}
mkdir -p .tools/axe
python3 - "$wheel" "$target.tmp" <<'PY'
import sys, zipfile

with zipfile.ZipFile(sys.argv[1]) as wheel, open(sys.argv[2], "wb") as target:
    target.write(wheel.read("axe_playwright_python/axe.min.js"))
PY
mv "$target.tmp" "$target"
echo "$version" >.tools/axe/version
