"""The peer's estimator behind NVIDIA Triton (`nvidia-pytriton`) instead of FastAPI. It runs on the CPU.

With `--queue` Triton itself refuses what would wait behind so many. Start it with `LD_LIBRARY_PATH` set to the folder
of Python's own library: Triton's stub may otherwise load another Python of the same minor version, and fail.
"""

import argparse
import signal
import sys

import cv2
import numpy as np
from peer import Estimator, options
from pytriton.model_config import DynamicBatcher, ModelConfig, QueuePolicy, Tensor
from pytriton.model_config.common import TimeoutAction
from pytriton.triton import Triton, TritonConfig


def main():
    parser = options(argparse.ArgumentParser())
    for name in ("grpc-port", "metrics-port"):
        parser.add_argument(f"--{name}", type=int, required=True)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    estimator = Estimator(args)

    def infer(requests):
        return [{"answer": np.frombuffer(answer(request), np.uint8)[None]} for request in requests]

    def answer(request):
        wanted = set(filter(None, request["objects"].tobytes().decode().strip().split(",")))
        return estimator(request["image"][0], request["camera"].tobytes().decode(), wanted)

    policy = QueuePolicy(max_queue_size=args.queue, timeout_action=TimeoutAction.REJECT)
    batcher = DynamicBatcher(default_queue_policy=policy) if args.queue else DynamicBatcher()
    ports = TritonConfig(http_port=args.port, grpc_port=args.grpc_port, metrics_port=args.metrics_port)
    with Triton(config=ports) as triton:
        triton.bind(
            "poses",
            infer_func=[infer] * args.pool,
            inputs=[Tensor(name=name, dtype=np.uint8, shape=(-1,)) for name in ("image", "camera", "objects")],
            outputs=[Tensor(name="answer", dtype=np.uint8, shape=(-1,))],
            config=ModelConfig(max_batch_size=1, batcher=batcher),  # only what batches has a limit of its queue
        )
        triton.run()
        while True:
            signal.pause()


signal.signal(signal.SIGTERM, lambda *_: sys.exit())
main()
