#!/usr/bin/env bash
# Trains all demo models: `train-demo.sh DATA`, DATA holding rendered/ and backgrounds/. Stopped, it goes on where it was.
set -euo pipefail
data=$(realpath "$1")
cd "$(dirname "$0")"
train=.venv/bin/posed-train

$train render demo/models "$data/rasterised" --scenes 720
for object in cube bracket; do
	$train keypoints "demo/$object.toml" --data "$data" --models ../models
	$train keypoints "demo/fine-tune/$object.toml" --data "$data" --models ../models \
		--runs runs/fine-tune --init "runs/$object/checkpoint.pt"
done
$train detector demo/detector.toml --data "$data" --models ../models --init runs/cube/checkpoint.pt
