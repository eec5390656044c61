#!/usr/bin/env bash
# Times the networks on a GPU, beside the CPU: `scripts/bench-gpu.sh [TABLE.md]` on a machine with an NVIDIA driver for
# CUDA 12, cargo, gcc and Python 3.11. Fetches ONNX Runtime with CUDA and TensorRT (4 GB) into target/gpu. TensorRT builds its
# engines on the first run, in 16-bit floats, and keeps them there.
set -euo pipefail
cd "$(dirname "$0")/.."

nvidia-smi --query-gpu=name,driver_version --format=csv,noheader
environment=target/gpu
if [ ! -f $environment/.done ]; then
	python3 -m venv $environment
	$environment/bin/python -m pip install --quiet --disable-pip-version-check \
		'onnxruntime-gpu[cuda,cudnn]==1.26.0' 'tensorrt-cu12-libs>=10.9,<11'
	touch $environment/.done
fi
packages=$($environment/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
libraries=$(find "$packages/nvidia" "$packages/tensorrt_libs" -name '*.so*' -printf '%h\n' | sort -u | paste -sd:)

make --silent target/baseline/models
export XDG_CACHE_HOME=$PWD/target/gpu/cache # of the engines
ORT_DYLIB_PATH=$(echo "$packages"/onnxruntime/capi/libonnxruntime.so.*) \
	LD_LIBRARY_PATH="$libraries${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" \
	POSED_BASELINE=target/baseline/models POSED_BENCH_OUT="${1:-target/gpu/networks.md}" \
	cargo bench --locked --bench networks
