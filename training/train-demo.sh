#!/usr/bin/env bash
# Trains all demo models: `train-demo.sh DATA`, DATA holding rendered/, cycles/ (more scenes like those of rendered/train)
# and backgrounds/. Stopped, it goes on where it was.
set -euo pipefail
data=$(realpath "$1")
cd "$(dirname "$0")"
train=.venv/bin/posed-train

keypoints() { # settings, runs, checkpoint to start from
	$train keypoints "demo/$1" --data "$data" --models ../models --runs "$2" ${3:+--init "$3"}
}

[ -d "$data/rasterised" ] || $train render demo/models "$data/rasterised" --scenes 720
for object in cube bracket; do
	keypoints $object.toml runs
	keypoints fine-tune/$object.toml runs/fine-tune runs/$object/checkpoint.pt
	keypoints more-keypoints/$object.toml runs/more-keypoints runs/fine-tune/$object/checkpoint.pt
done
for object in motor link; do
	keypoints $object.toml runs runs/fine-tune/cube/checkpoint.pt
	keypoints more-keypoints/$object.toml runs/more-keypoints runs/$object/checkpoint.pt
done
$train detector demo/detector.toml --data "$data" --models ../models --init runs/cube/checkpoint.pt
