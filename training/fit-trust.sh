#!/usr/bin/env bash
# Fits what `ok`, `confidence` and `covariance` of the demo models promise: `fit-trust.sh DATA`, DATA as `train-demo.sh`
# has it. To be run again whenever a network, the detector or a reference changes. docs/benchmarks/trust.md says what it
# is fitted on.
set -euo pipefail
data=$(realpath "$1")
cd "$(dirname "$0")"
train=.venv/bin/posed-train
export ORT_DYLIB_PATH=${ORT_DYLIB_PATH:-$PWD/../.onnxruntime/libonnxruntime.so}

$train render demo/models "$data/trust/copies" --engine cycles --scenes 27 --views 2 --first 130000 --copies 2
# Scenes that no keypoint net has learned from.
scenes=("$data"/rendered/train/*)
mkdir -p "$data/trust/held-out"
for scene in "${scenes[@]: -6}"; do
	ln -sfn "$scene" "$data/trust/held-out/"
done
also=()
for trouble in white-balance gamma jpeg blur noise desaturated swapped few-bits merged covered; do
	for strength in 1 3 5; do
		out=$data/trust/$trouble-$strength
		if [ ! -d "$out" ]; then
			rm -rf "$out.part"
			$train corrupt "$data/rendered/train" "$out.part" --scenes 6 --trouble "$trouble" --strength "$strength"
			mv "$out.part" "$out"
		fi
		also+=(--also "$out")
	done
done
$train trust cube bracket motor link --meshes demo/models --models ../models --reference ../reference \
	--posed ../target/release/posed --split "$data/trust/held-out" --split "$data/trust/copies" "${also[@]}"
