"""posed and its peers in one run: only one is loaded at a time, in rounds that alternate. Writes a page and a plot.

`python compare.py docs/benchmarks/compare.md [--split DIR] [--seconds 3] [--rounds 5]`
"""

import argparse
import asyncio
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import accuracy
import client
import numpy as np
import report
from servers import HERE, ROOT, Peer, Posed, Triton

FLOAT_COMMIT = "b1f939f"
"""The last commit whose demo networks compute in floats."""
CPU, OPENVINO = "CPUExecutionProvider", "OpenVINOExecutionProvider"
CLIENTS = (1, 4, 8, 16)
QUEUE = 16
"""Images that posed lets wait; a peer is measured without a limit and with this one."""
ONE_IMAGE = "one image at once, networks of 2 threads"
CHOICES = {
    ONE_IMAGE: ["--pool=1", "--threads=2"],
    "the same, spinning": ["--pool=1", "--threads=2", "--spin"],
    "two images at once, networks of 1 thread": ["--pool=2", "--threads=1"],
    "two images at once, networks of 2 threads": ["--pool=2", "--threads=2"],
    "two processes, networks of 1 thread": ["--workers=2", "--pool=1", "--threads=1"],
}
POSED_DEFAULT = "two images at once, networks of 1 thread"
POSED_CHOICES = {
    ONE_IMAGE: ["--workers=1", "--threads=2"],
    POSED_DEFAULT: [],  # on two cores
    "two images at once, networks of 2 threads": ["--workers=2", "--threads=2"],
}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("page", type=Path)
    parser.add_argument("--split", type=Path, help="a split in the BOP format of the demo objects")
    parser.add_argument("--split-name", default="a split", help="what the page calls it")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=3.0, help="of a load in a round")
    parser.add_argument("--results", type=Path, help="also write all measurements, as JSON")
    parser.add_argument("--overload", type=float, default=15.0, help="seconds")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        run = Run(args, Path(work))
        try:
            results = run.measure()
        finally:
            run.stop_all()
    if args.results:
        args.results.write_text(json.dumps(results))
    report.write(args, results)


class Run:
    def __init__(self, args, work):
        self.args, self.work, self.started = args, work, []
        self.image = (ROOT / "samples/sample-1.jpg").read_bytes()
        self.cameras = work / "cameras"
        self.cameras.mkdir()
        shutil.copy(ROOT / "samples/demo.camera.json", self.cameras)
        self.truths = {"samples": list(accuracy.samples())}
        if args.split:
            self.truths["split"] = list(accuracy.split(args.split, self.cameras))
        floats = work / "floats"
        floats.mkdir()
        archive = ["git", "-C", ROOT, "archive", FLOAT_COMMIT, "models", "reference"]
        content = subprocess.run(archive, check=True, capture_output=True).stdout
        subprocess.run(["tar", "x", "-C", floats], check=True, input=content)
        self.kinds = {
            "FastAPI, floats": (Peer, ".venv-cpu", CPU, floats),
            "FastAPI, OpenVINO": (Peer, ".venv-openvino", OPENVINO, ROOT),
            "Triton, OpenVINO": (Triton, ".venv-triton", OPENVINO, ROOT),
        }
        if not (HERE / ".venv-triton/.done").exists():
            del self.kinds["Triton, OpenVINO"]

    def start(self, name, settings=()):
        log = self.work / "log"
        if name == "posed":
            server = Posed(self.cameras, list(settings), self.image, log)
        else:
            kind, venv, provider, nets = self.kinds[name]
            server = kind(name, venv, provider, nets, self.cameras, list(settings), self.image, log)
        self.started.append(server)
        return server

    def stop_all(self):
        for server in self.started:
            server.stop()

    def measure(self):
        results = {"cores": os.cpu_count(), "load_before": os.getloadavg(), "began": time.time()}
        results["choices"] = choices = self.choose()
        best = {name: max(tried, key=lambda t: np.prod(tried[t]["rates"])) for name, tried in choices.items()}
        best["posed"] = POSED_DEFAULT
        # Triton runs the same estimator: it gets the same settings, without processes of its own.
        threads = {choice: of for choice, of in choices["FastAPI, OpenVINO"].items() if "process" not in choice}
        best["Triton, OpenVINO"] = max(threads, key=lambda t: np.prod(threads[t]["rates"]))
        results["best"] = best
        names = ["posed", *self.kinds]
        settings = {name: CHOICES[best[name]] if name != "posed" else [] for name in names}
        results["starts_s"] = {name: [] for name in names}
        servers = {}
        for _ in range(3):
            for name in names:
                if name in servers:
                    servers[name].stop()
                servers[name] = self.start(name, settings[name])
                results["starts_s"][name].append(servers[name].start_s)
        say("starts", results["starts_s"])
        results["accuracy"] = self.score(servers)
        results["four"] = self.rounds(servers, CLIENTS, self.args.rounds, self.args.seconds, "")
        results["one"] = self.rounds(servers, (1, 8), self.args.rounds, self.args.seconds * 2 / 3, "cube")
        results["over"], results["rss_mib"] = {}, {}
        for name, server in servers.items():
            self.overload(results["over"], name, server)
            results["rss_mib"][name] = server.usage()[0]
            server.stop()
            if name != "posed":
                limited = self.start(name, [*settings[name], f"--queue={QUEUE}"])
                self.overload(results["over"], f"{name}, limit", limited)
                limited.stop()
        results["load_after"], results["ended"] = os.getloadavg(), time.time()
        return results

    def choose(self):
        """What an engineer would try: each setting with 1 and 8 clients, in turns."""
        tried = {}
        for name in ("posed", *self.kinds):
            if name.startswith("Triton"):
                continue
            servers = {}
            for choice, settings in (POSED_CHOICES if name == "posed" else CHOICES).items():
                if "spinning" not in choice or self.kinds[name][2] == CPU:
                    servers[choice] = self.start(name, settings)
            rates = {choice: ([], []) for choice in servers}
            tried[name] = {choice: {"cpu_ms": []} for choice in servers}
            for _ in range(2):
                for choice, server in servers.items():
                    for at, clients in enumerate((1, 8)):
                        load = server.closed(server.message(self.image), clients, 2.0)
                        rates[choice][at].append(load["rate"])
                        tried[name][choice]["cpu_ms"].append(load["cpu_ms"])
            for choice, server in servers.items():
                tried[name][choice]["rates"] = [float(np.mean(of)) for of in rates[choice]]
                tried[name][choice]["rss_mib"] = server.usage()[0]
                server.stop()
            say(name, tried[name])
        return tried

    def score(self, servers):
        scores = {}
        for what, truths in self.truths.items():
            for name, server in servers.items():
                answers = [server.poses(truth.image, truth.camera) for truth in truths]
                scores.setdefault(what, {})[name] = vars(accuracy.score(truths, answers))
                if name == "posed":
                    trusted = [[pose for pose in poses if pose["status"] == "ok"] for poses in answers]
                    scores[what]["posed, `ok` alone"] = vars(accuracy.score(truths, trusted))
        return json.loads(json.dumps(scores, default=float))

    def rounds(self, servers, clients, rounds, seconds, objects):
        results = {name: {str(count): [] for count in clients} for name in servers}
        for number in range(rounds):
            for count in clients:
                for name, server in servers.items():
                    message = server.message(self.image, objects=objects)
                    results[name][str(count)].append(server.closed(message, count, seconds))
            rates = {name: {c: round(of[c][-1]["rate"], 1) for c in of} for name, of in results.items()}
            say(f"round {number + 1}{' ' + objects if objects else ''}", rates)
        return results

    def overload(self, results, name, server):
        """At twice what it can do in this minute: others work here, too."""
        capacity = server.closed(server.message(self.image), 8, self.args.seconds)["rate"]
        load = asyncio.run(client.opened(server.port, server.message(self.image), 2 * capacity, self.args.overload))
        results[name] = vars(load) | {"rate": load.rate, "asked": 2 * capacity}
        answered = {k: len(v) if isinstance(v, list) else v for k, v in results[name].items()}
        say(f"overload of {name}", answered)


def say(what, values):
    print(f"{what}: {json.dumps(values, default=float)}", file=sys.stderr, flush=True)


main()
