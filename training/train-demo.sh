#!/usr/bin/env bash
# Trains all demo models: `train-demo.sh DATA`, DATA holding rendered/ and backgrounds/. Stopped, it goes on where it was.
set -euo pipefail
data=$(realpath "$1")
cd "$(dirname "$0")"
train=.venv/bin/posed-train

$train render demo/models "$data/rasterised"
for object in cube bracket motor; do
	$train keypoints "demo/$object.toml" --data "$data" --models ../models
done
$train detector demo/detector.toml --data "$data" --models ../models --init runs/cube/checkpoint.pt
