#!/usr/bin/env bash
# Puts ONNX Runtime's shared library at .onnxruntime/libonnxruntime.so: taken from the Python wheel of the same
# version, checked against its hash. Does nothing when it is there already.
set -euo pipefail
cd "$(dirname "$0")/.."

version=1.31.1
case "$(uname -m)" in
x86_64) sha256=5752bd508126ae7c49894d3b9d2e83f0c3d487319246d04c444b393308d7ad7f ;;
aarch64) sha256=da05378364c44d4407e463982d2bf8d5e4cfea873283757e48beeb41df97b7f3 ;;
*)
	echo "fetch-onnxruntime: no wheel for $(uname -m); build ONNX Runtime $version and set ORT_DYLIB_PATH" >&2
	exit 1
	;;
esac
target=.onnxruntime/libonnxruntime.so
[ "$(cat .onnxruntime/version 2>/dev/null)" = "$version" ] && [ -f "$target" ] && exit 0

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m pip download --quiet --disable-pip-version-check --no-deps --only-binary=:all: \
	--python-version 3.11 --implementation cp -d "$work" "onnxruntime==$version"
wheel=$(echo "$work"/*.whl)
echo "$sha256  $wheel" | sha256sum --check --quiet || {
	echo "fetch-onnxruntime: $wheel is not the expected file" >&2
	exit 1
}
mkdir -p .onnxruntime
python3 - "$wheel" "$target.tmp" <<'PY'
import shutil, sys, zipfile

with zipfile.ZipFile(sys.argv[1]) as wheel:
    name = next(n for n in wheel.namelist() if n.startswith("onnxruntime/capi/libonnxruntime.so."))
    with wheel.open(name) as source, open(sys.argv[2], "wb") as target:
        shutil.copyfileobj(source, target)
PY
mv "$target.tmp" "$target"
echo "$version" >.onnxruntime/version
