#!/usr/bin/env bash
# Trains the full-width nets of the demo objects on a GPU: `train-full.sh DATA [OBJECT...]`, DATA holding rendered/,
# rasterised/ (made here if it is missing) and backgrounds/. Stopped, it goes on where it was.
set -euo pipefail
data=$(realpath "$1")
shift
cd "$(dirname "$0")"
train=${POSED_TRAIN:-.venv/bin/posed-train}

[ -d "$data/rasterised" ] || $train render demo/models "$data/rasterised" --scenes 720
for object in ${*:-cube bracket motor link}; do
	$train keypoints "demo/full/$object.toml" --data "$data" --models ../models --runs runs/full \
		--workers "$(($(nproc) - 1))"
done
