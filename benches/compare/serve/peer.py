"""The same networks behind FastAPI, ONNX Runtime and OpenCV: what posed is compared with.

One process. The sessions are made once; images are worked on by `--pool` threads, each network runs on `--threads`.
Looks are those of posed's demo networks: one crop by the detector's box, then the crops of `crop_ensemble` about the
keypoints of the first. There are always two looks, and no covariance, status or limit on what is wrong.
"""

import argparse
import asyncio
import json
import os
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np
import onnxruntime as ort
import orjson
import uvicorn
from fastapi import FastAPI, HTTPException, Request, Response


class Net:
    """A network. OpenVINO is faster with fixed batches: there it has a session for each of `batches`."""

    def __init__(self, path, args, batches=()):
        provider, options = args.provider, {}
        if provider == "OpenVINOExecutionProvider":
            config = {"CPU": {"INFERENCE_PRECISION_HINT": "f32", "ENABLE_CPU_PINNING": "NO"}}
            options = {"device_type": "CPU", "num_of_threads": str(args.threads), "load_config": json.dumps(config)}
            options["num_streams"] = str(args.pool)
        else:
            batches = ()
        self.sessions = []
        for batch in sorted(batches, reverse=True) or [None]:
            settings = ort.SessionOptions()
            settings.intra_op_num_threads = args.threads
            settings.add_session_config_entry("session.intra_op.allow_spinning", str(int(args.spin)))
            if batch:
                settings.add_free_dimension_override_by_name("batch", batch)
            self.sessions.append((batch, ort.InferenceSession(path, settings, [provider], [options])))
        self.name = self.sessions[0][1].get_inputs()[0].name

    def run(self, output, images):
        parts = []
        while len(images):
            batch, session = next(s for s in self.sessions if s[0] is None or s[0] <= len(images))
            parts.append(session.run([output], {self.name: images[:batch]})[0])
            images = images[batch or len(images) :]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


class Object:
    def __init__(self, folder, reference, args):
        self.about = json.loads((folder / "object.json").read_text())
        self.keypoints = np.array(self.about["virtual_keypoints_m"])
        self.size, self.scale = self.about["input"]["size"], self.about["crop_scale"]
        self.variants = [(v["scale"], np.radians(v["turn_deg"])) for v in self.about["crop_ensemble"]]
        self.zoom = self.about["second_look"]["zoom"]
        self.heights = self.keypoints @ np.array(self.about["second_look"]["up"])
        self.net = Net(folder / "keypoints.onnx", args, {1, len(self.variants)})
        offset = json.loads(reference.read_text())["object_from_keypoints"]
        x, y, z, w = offset["rotation_xyzw"]
        turn = cv2.Rodrigues(2 * np.arctan2(np.linalg.norm([x, y, z]), w) * unit(np.array([x, y, z])))[0]
        self.rotation, self.translation = turn.T, -turn.T @ np.array(offset["translation_m"])  # keypoints from object

    def look(self, image, places):
        """Keypoints [P, N, 2] in the image of places (centre, side, turn): the mean over each place's crops."""
        variants = [(1.0, 0.0)] if len(places[0]) == 3 else self.variants
        crops = np.empty((len(places) * len(variants), self.size, self.size, 3), np.uint8)
        back = []
        for at, (place, (scale, turn)) in enumerate((p, v) for p in places for v in variants):
            angle, zoom = place[2] + turn, self.size / (place[1] * self.scale * scale)
            linear = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            shift = (self.size - 1) / 2 - linear @ place[0]
            cv2.warpAffine(image, np.column_stack([linear, shift]), (self.size, self.size), crops[at])
            back.append((np.linalg.inv(linear).T, shift))
        found = self.net.run("keypoints", crops)
        found = np.stack([(points - shift) @ linear for points, (linear, shift) in zip(found, back, strict=True)])
        return found.reshape(len(places), len(variants), -1, 2).mean(1)

    def closer(self, points, first):
        """Where to look again, or nothing where that is no place for the object of this box."""
        centre = points.mean(0)
        arms = points - centre
        side, axis = self.zoom * np.sqrt((arms**2).sum(1).mean()), self.heights @ arms
        near = np.abs(centre - first[0]).max() <= first[1] and 0.5 <= side / first[1] <= 2.5
        return (centre, side, np.arctan2(-axis[0], -axis[1]), "closer") if near else None

    def poses(self, image, boxes, camera):
        first = [((box[:2] + box[2:]) / 2 - 0.5, (box[2:] - box[:2]).max(), 0.0) for box in boxes]
        points = self.look(image, first)
        second = [(at, place) for at, f in enumerate(first) if (place := self.closer(points[at], f))]
        if second:
            points[[at for at, _ in second]] = self.look(image, [place for _, place in second])
        return [self.pose(p, camera) for p in points.astype(float)]

    def pose(self, points, camera):
        _, turn, shift = cv2.solvePnP(self.keypoints, points, camera, None, flags=cv2.SOLVEPNP_SQPNP)
        turn, shift = cv2.solvePnPRefineLM(self.keypoints, points, camera, None, turn, shift)
        rotation = cv2.Rodrigues(turn)[0]
        turn, shift = cv2.Rodrigues(rotation @ self.rotation)[0].ravel(), shift.ravel() + rotation @ self.translation
        half = np.linalg.norm(turn) / 2
        return {"rotation_xyzw": [*(np.sin(half) * unit(turn)), np.cos(half)], "translation_m": shift}


def unit(vector):
    return vector / max(np.linalg.norm(vector), 1e-12)


class Estimator:
    def __init__(self, args):
        self.about = json.loads((args.models / "detector/detector.json").read_text())
        self.detector = Net(args.models / "detector/detector.onnx", args)
        names = filter(None, self.about["labels"])
        self.objects = {n: Object(args.models / n, args.reference / f"{n}.json", args) for n in names}
        self.cameras = {}
        for path in args.cameras.glob("*.camera.json"):
            c = json.loads(path.read_text())
            matrix = np.array([[c["fx"], 0, c["cx"]], [0, c["fy"], c["cy"]], [0, 0, 1]])
            self.cameras[path.name.removesuffix(".camera.json")] = matrix

    def detect(self, image):
        to = self.about["input"]
        scale = min(to["width"] / image.shape[1], to["height"] / image.shape[0])
        width, height = round(scale * image.shape[1]), round(scale * image.shape[0])
        batch = np.full((1, to["height"], to["width"], 3), to["fill"], np.uint8)
        batch[0, :height, :width] = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        found = self.detector.run("detections", batch)[0]
        found = found[found[:, 4] >= self.about["score_threshold"]]
        return found[:, :4] / scale, found[:, 4], [self.about["labels"][int(label)] for label in found[:, 5]]

    def __call__(self, data, camera, wanted):
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB)
        if image is None:
            raise HTTPException(400, "not an image")
        boxes, scores, labels = self.detect(image)
        order = sorted((label, at) for at, label in enumerate(labels) if not wanted or label in wanted)
        poses = []
        for label, group in groupby(order, lambda pair: pair[0]):
            at = [index for _, index in group]
            found = self.objects[label].poses(image, boxes[at], self.cameras[camera])
            for index, pose in zip(at, found, strict=True):
                x, y, right, bottom = boxes[index]
                box = {"box_px": [x, y, right - x, bottom - y], "score": scores[index]}
                poses.append({"object": label, "detection": box, "camera_from_object": pose})
        return orjson.dumps({"poses": poses}, option=orjson.OPT_SERIALIZE_NUMPY)


def application(args):
    estimator, pool, app, waiting = Estimator(args), ThreadPoolExecutor(args.pool), FastAPI(), 0

    @app.post("/v1/poses")
    async def poses(request: Request, camera: str, objects: str = ""):
        nonlocal waiting
        if args.queue and waiting >= args.queue:
            raise HTTPException(503, "busy")
        if camera not in estimator.cameras:
            raise HTTPException(404, "unknown camera")
        waiting += 1
        try:
            data, wanted = await request.body(), set(filter(None, objects.split(",")))
            answer = await asyncio.get_running_loop().run_in_executor(pool, estimator, data, camera, wanted)
        finally:
            waiting -= 1
        return Response(answer, media_type="application/json")

    return app


def options(parser):
    for name in ("models", "reference", "cameras"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--provider", default="CPUExecutionProvider")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="of each network")
    parser.add_argument("--pool", type=int, default=1, help="images worked on at once")
    parser.add_argument("--spin", action="store_true", help="let ONNX Runtime's threads spin")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--queue", type=int, default=0, help="images waiting or in progress; more get 503")
    parser.add_argument("--port", type=int, required=True)
    return parser


def factory():
    cv2.setNumThreads(1)
    return application(options(argparse.ArgumentParser()).parse_args())


if __name__ == "__main__":
    given = options(argparse.ArgumentParser()).parse_args()
    target = "peer:factory" if given.workers > 1 else factory()
    uvicorn.run(
        target, factory=given.workers > 1, workers=given.workers, port=given.port, log_level="error", access_log=False
    )
