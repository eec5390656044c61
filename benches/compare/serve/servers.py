"""The servers as processes."""

import asyncio
import json
import os
import signal
import socket
import subprocess
import sysconfig
import time
from pathlib import Path
from urllib.parse import quote

import client

HERE = Path(__file__).parent
ROOT = HERE.parents[2]


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Server:
    """Ports are free ones. `start_s` is the time to the first answer."""

    def __init__(self, image, log):
        self.port, self.more_ports = free_port(), (free_port(), free_port())
        self.image, start = image, time.perf_counter()
        environment = os.environ | self.environment()
        with open(log, "ab") as output:
            self.process = subprocess.Popen(
                self.command(), cwd=ROOT, env=environment, stdout=output, stderr=output, start_new_session=True
            )
        message = self.message(image)
        while asyncio.run(client.once(self.port, message))[0] != 200:
            if self.process.poll() is not None or time.perf_counter() - start > 120:
                self.stop()
                raise SystemExit(f"{self.command()} does not answer; see {log}")
            time.sleep(0.01)
        self.start_s = time.perf_counter() - start

    def environment(self):
        return {}

    def message(self, image, camera="demo", objects=""):
        """A whole HTTP request."""
        path = f"/v1/poses?camera={camera}" + (f"&objects={quote(objects)}" if objects else "")
        return request(path, "content-type: application/octet-stream\r\n", image)

    def poses(self, image, camera):
        """What it says of an image."""
        status, body = asyncio.run(client.once(self.port, self.message(image, camera)))
        assert status == 200, f"{self.name}: status {status}"
        return json.loads(self.json(body))["poses"]

    def json(self, body):
        return body

    def usage(self):
        """Resident memory in MiB and time of processors in seconds, of the process and all below it."""
        memory, ticks, below = 0, 0, [self.process.pid]
        while below:
            process = Path(f"/proc/{below.pop()}")
            try:
                lines = (process / "status").read_text().splitlines()
                memory += sum(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))
                ticks += sum(map(int, (process / "stat").read_text().rsplit(")", 1)[1].split()[11:13]))
                tasks = list((process / "task").iterdir())
                below += [int(child) for task in tasks for child in (task / "children").read_text().split()]
            except OSError:
                continue
        return memory / 1024, ticks / os.sysconf("SC_CLK_TCK")

    def closed(self, message, clients, seconds):
        """A load, and the milliseconds of processors that an image took."""
        before = self.usage()[1]
        load = asyncio.run(client.closed(self.port, message, clients, seconds))
        spent = 1e3 * (self.usage()[1] - before)
        return vars(load) | {"rate": load.rate, "cpu_ms": spent / max(len(load.answered), 1)}

    def stop(self):
        """Also what it started."""
        if self.process.returncode is not None:
            return
        self.process.terminate()
        try:
            self.process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


class Posed(Server):
    name = "posed"

    def __init__(self, cameras, settings, image, log):
        self.cameras, self.settings = cameras, settings
        super().__init__(image, log)

    def command(self):
        grpc, admin = self.more_ports
        ports = {"http": self.port, "grpc": grpc, "admin": admin}
        given = [*(f"--{name}=127.0.0.1:{port}" for name, port in ports.items()), f"--cameras={self.cameras}"]
        return [ROOT / "target/release/posed", "serve", *given, "--log=error", *self.settings]


class Peer(Server):
    """`settings` are what an engineer may choose: images at once, threads of a network, processes."""

    program = "peer.py"

    def __init__(self, name, venv, provider, nets, cameras, settings, image, log):
        self.name, self.venv, self.provider, self.nets = name, venv, provider, nets
        self.cameras, self.settings = cameras, settings
        super().__init__(image, log)

    def command(self):
        program = [HERE / self.venv / "bin/python", HERE / self.program]
        folders = {"models": self.nets / "models", "reference": self.nets / "reference", "cameras": self.cameras}
        given = folders | {"provider": self.provider, "port": self.port}
        return [*program, *(f"--{name}={value}" for name, value in given.items()), *self.settings]

    def environment(self):
        return {"PYTHONPATH": str(HERE)}


class Triton(Peer):
    program = "peer_triton.py"

    def command(self):
        grpc, metrics = self.more_ports
        return [*super().command(), f"--grpc-port={grpc}", f"--metrics-port={metrics}"]

    def environment(self):
        return super().environment() | {"LD_LIBRARY_PATH": sysconfig.get_config_var("LIBDIR")}

    def message(self, image, camera="demo", objects=""):
        values = {"image": image, "camera": camera.encode(), "objects": objects.encode() or b" "}
        inputs = [
            {"name": name, "shape": [1, len(data)], "datatype": "UINT8", "parameters": {"binary_data_size": len(data)}}
            for name, data in values.items()
        ]
        head = json.dumps({"inputs": inputs, "parameters": {"binary_data_output": True}}).encode()
        length = f"inference-header-content-length: {len(head)}\r\n"
        return request("/v2/models/poses/infer", length, head + b"".join(values.values()))

    def json(self, body):
        head, end = json.JSONDecoder().raw_decode(body.decode("latin-1"))
        return body[end:]


def request(path, headers, body):
    head = f"POST {path} HTTP/1.1\r\nhost: localhost\r\n{headers}content-length: {len(body)}\r\n\r\n"
    return head.encode() + body
