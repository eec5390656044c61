#!/usr/bin/env bash
# Puts ONNX Runtime's shared library at .onnxruntime/libonnxruntime.so, for x86-64 one with OpenVINO: taken from a Python
# wheel, checked against its hash. Does nothing when it is there already.
set -euo pipefail
cd "$(dirname "$0")/.."

case "$(uname -m)" in
x86_64)
	package=onnxruntime-openvino
	version=1.24.1
	sha256=3007c803634cc69c6d52af1dea7ce729d9bb62b9a11070fd2f959119199007a8
	platform=manylinux_2_28_x86_64
	;;
aarch64)
	package=onnxruntime
	version=1.31.1
	sha256=da05378364c44d4407e463982d2bf8d5e4cfea873283757e48beeb41df97b7f3
	platform=manylinux_2_28_aarch64
	;;
*)
	echo "fetch-onnxruntime: no wheel for $(uname -m); build ONNX Runtime 1.24 or newer and set ORT_DYLIB_PATH" >&2
	exit 1
	;;
esac
[ "$(cat .onnxruntime/version 2>/dev/null)" = "$package $version" ] && exit 0

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m pip download --quiet --disable-pip-version-check --no-deps --only-binary=:all: \
	--python-version 3.11 --implementation cp --abi cp311 --platform "$platform" -d "$work" "$package==$version"
wheel=$(echo "$work"/*.whl)
echo "$sha256  $wheel" | sha256sum --check --quiet || {
	echo "fetch-onnxruntime: $wheel is not the expected file" >&2
	exit 1
}
rm -rf .onnxruntime
mkdir -p .onnxruntime
# Of OpenVINO, what its CPU plugin needs: what runs ONNX files on GPUs and NPUs stays out.
python3 - "$wheel" .onnxruntime <<'PY'
import re, shutil, sys, zipfile

NEEDED = {
    r"libonnxruntime\.so\..*": "libonnxruntime.so",
    r"libonnxruntime_providers_(shared|openvino)\.so": None,
    r"libopenvino(_onnx_frontend)?\.so\.\d+": None,
    r"libopenvino_intel_cpu_plugin\.so": None,
    r"libtbb\.so\.\d+": None,
}
with zipfile.ZipFile(sys.argv[1]) as wheel:
    for member in wheel.namelist():
        folder, _, name = member.rpartition("/")
        for pattern, new_name in NEEDED.items():
            if folder == "onnxruntime/capi" and re.fullmatch(pattern, name):
                with wheel.open(member) as source, open(f"{sys.argv[2]}/{new_name or name}", "wb") as target:
                    shutil.copyfileobj(source, target)
PY
echo "$package $version" >.onnxruntime/version
