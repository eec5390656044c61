#!/usr/bin/env bash
# Trains the full-width nets of the demo objects on a GPU: `train-full.sh DATA [OBJECT...]`, DATA as `train-demo.sh` has it,
# or what `posed-train pack demo/full/OBJECT.toml` made of it for one object. Stopped, it goes on where it was.
set -euo pipefail
data=$(realpath "$1")
shift
cd "$(dirname "$0")"
train=${POSED_TRAIN:-.venv/bin/posed-train}

for object in ${*:-cube bracket motor link}; do
	$train keypoints "demo/full/$object.toml" --data "$data" --models ../models --runs runs/full \
		--workers "$(($(nproc) - 1))"
done
