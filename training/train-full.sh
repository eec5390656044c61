#!/usr/bin/env bash
# Trains large nets of the demo objects on a GPU: `train-full.sh DATA [OBJECT...]`, DATA as `train-demo.sh` has it, or what
# `posed-train pack demo/full/OBJECT.toml` made of it for one object. NETWORK is `lite0-224`, from ImageNet, or `paper`,
# the paper's ResNet-18. Stopped, it goes on where it was. The nets are in runs/full-NETWORK/models; those that ship
# stay as they are.
set -euo pipefail
data=$(realpath "$1")
shift
cd "$(dirname "$0")"
train=${POSED_TRAIN:-.venv/bin/posed-train}
network=${NETWORK:-lite0-224}
out=runs/full-$network

mkdir -p "$out"
for object in ${*:-cube bracket motor link}; do
	sed "s/^network = .*/network = \"$network\"/" "demo/full/$object.toml" >"$out/$object.toml"
	$train keypoints "$out/$object.toml" --data "$data" --models "$out/models" --runs "$out" \
		--workers "$(($(nproc) - 1))"
done
