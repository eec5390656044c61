#!/usr/bin/env bash
# Trains all demo models: `train-demo.sh DATA`, DATA holding backgrounds/, a folder of photos; what else is missing is
# rendered there. Stopped, it goes on where it was. After it, calibrate the references anew
# (`benches/choose_reference.py`) and run `fit-trust.sh`.
set -euo pipefail
data=$(realpath "$1")
cd "$(dirname "$0")"
train=.venv/bin/posed-train

keypoints() { # settings, runs, checkpoint to start from
	$train keypoints "demo/$1" --data "$data" --models ../models --runs "$2" ${3:+--init "$3"}
}

images() { # folder in DATA, options of `posed-train render`
	$train render demo/models "$data/$1" "${@:2}"
}

images rasterised --scenes 720 --views 6
images rendered/train --engine cycles --scenes 70 --views 8
images rendered/val --engine cycles --scenes 5 --views 8 --first 100000
images cycles --engine cycles --scenes 38 --views 8 --first 3000
images cycles-pairs --engine cycles --scenes 66 --views 2 --first 10000
images cycles-singles --engine cycles --scenes 586 --views 1 --first 20000
images cycles-alike --engine cycles --scenes 536 --views 1 --first 40000 --camouflage 0.3
images cycles-camouflage --engine cycles --scenes 220 --views 1 --first 60000 --camouflage 0.7
images cycles-copies --engine cycles --scenes 506 --views 1 --first 70000 --camouflage 0.6 --objects 2 4 --copies 4
images cycles-copies --engine cycles --scenes 518 --views 1 --first 80000 --camouflage 0.6 --objects 1 3 --copies 4
images cycles-copies --engine cycles --scenes 240 --views 1 --first 71000 --camouflage 0.6 --objects 2 4 --copies 4
images cycles-copies --engine cycles --scenes 120 --views 1 --first 81000 --camouflage 0.6 --objects 1 3 --copies 4
images cycles-link --engine cycles --scenes 487 --views 1 --first 72000 --camouflage 0.5 --objects 4 --copies 5
images cycles-crowd --engine cycles --scenes 230 --views 1 --first 73000 --camouflage 0.5 --objects 1 2 3 --copies 3
images cycles-cube-bracket --engine cycles --scenes 96 --views 1 --first 92000 --camouflage 0.5 --objects 1 2 --copies 4
images cycles-cube-bracket --engine cycles --scenes 101 --views 1 --first 93000 --camouflage 0.5 --objects 1 2 --copies 4
images rasterised-camouflage --scenes 236 --views 6 --first 50000 --camouflage 0.7
images rasterised-detector --scenes 160 --views 6 --first 50000 --camouflage 0.4
[ -d "$data/rendered/models" ] || cp -r demo/models "$data/rendered/models"

for object in cube bracket; do
	keypoints $object.toml runs
	keypoints fine-tune/$object.toml runs/fine-tune runs/$object/checkpoint.pt
	keypoints more-keypoints/$object.toml runs/more-keypoints runs/fine-tune/$object/checkpoint.pt
done
for object in motor link; do
	keypoints $object.toml runs runs/fine-tune/cube/checkpoint.pt
	keypoints more-keypoints/$object.toml runs/more-keypoints runs/$object/checkpoint.pt
done
for object in cube bracket motor link; do
	keypoints scale/$object.toml runs/scale runs/more-keypoints/$object/checkpoint.pt
	keypoints upright/$object.toml runs/upright runs/scale/$object/checkpoint.pt
done
for object in cube link; do
	keypoints camouflage/$object.toml runs/camouflage runs/upright/$object/checkpoint.pt
done
for object in cube link; do
	keypoints copies/$object.toml runs/copies runs/camouflage/$object/checkpoint.pt
done
for object in bracket motor; do
	keypoints copies/$object.toml runs/copies runs/upright/$object/checkpoint.pt
done
for object in cube bracket motor link; do
	keypoints finer/$object.toml runs/finer runs/copies/$object/checkpoint.pt
done
keypoints longer/link.toml runs/longer runs/finer/link/checkpoint.pt
keypoints half-hidden/cube.toml runs/half-hidden runs/finer/cube/checkpoint.pt
keypoints half-hidden/cube-2.toml runs/half-hidden-2 runs/half-hidden/cube/checkpoint.pt
keypoints half-hidden/link.toml runs/half-hidden runs/longer/link/checkpoint.pt
keypoints half-hidden/link-2.toml runs/half-hidden-2 runs/half-hidden/link/checkpoint.pt
keypoints half-hidden/link-3.toml runs/half-hidden-3 runs/half-hidden-2/link/checkpoint.pt
# Another cube, for other cameras.
$train keypoints demo/lite0/cube.toml --data "$data" --models demo/cameras --runs runs/lite0
$train keypoints demo/lite0/cube-2.toml --data "$data" --models demo/cameras --runs runs/lite0-2 --init runs/lite0/cube/best.pt
$train detector demo/detector.toml --data "$data" --models ../models
