"""The page and its plot."""

from importlib.metadata import version

import matplotlib
import numpy as np
from matplotlib.figure import Figure

COLOURS = {
    "posed": "#d1495b",
    "FastAPI, floats": "#8d96a3",
    "FastAPI, OpenVINO": "#00798c",
    "Triton, OpenVINO": "#edae49",
}

PAGE = """\
# posed and other servers of the same networks

`make bench-compare` writes this page in {minutes:.0f} minutes: posed, and what a good engineer would write in an
afternoon. Servers and clients share {cores} cores. All servers run, but only one is loaded at a time: {rounds} rounds,
in each {seconds:g} s for every number of clients and every server, one after the other. Rates are medians of rounds,
ratios medians of neighbours, latencies of all requests. The load average of other work was {before:.1f} when it
began{noise}.

- **posed**: `posed serve` with its defaults: OpenVINO, which `auto` chooses here, and the demo networks, which
  compute in 8 bits. Its answers have covariances, statuses and alternatives, and nine times as many bytes as others'.
- **FastAPI, floats**: FastAPI {fastapi}, uvicorn {uvicorn} with uvloop, ONNX Runtime {onnxruntime} with its CPU
  provider, OpenCV {opencv}. The demo networks before they were quantised, three crops in the second look.
- **FastAPI, OpenVINO**: the same program with the networks and the library of posed (`onnxruntime-openvino` 1.24.1),
  also with sessions for fixed sizes of batches.
{triton}

The peer is [`peer.py`](../../benches/compare/serve/peer.py). It looks as posed does: one crop by the detector's box,
then those of `crop_ensemble` about the keypoints of the first; then SQPNP and RefineLM. It takes no third look, and
says nothing of whether an answer is right.

## Settings of the peers

Images/s with 1 and 8 clients in two short rounds; time of processors for an image, ms; memory after it, MiB. The rest
of the page is for the setting of a peer with the largest product of the two rates, and for posed's default
(bold).{triton_setting}

{choices}

## Four objects in view: images/s

![Images/s by clients]({picture})

{four}

Latency in ms, p50 / p99:

{four_latency}

Time of processors for an image, ms. Other work on the machine changes it less than rates:

{four_cpu}

## One object asked for (`objects=cube`): images/s

{one}

Latency in ms, p50 / p99:

{one_latency}

## Twice the capacity

For {overload:g} s each server is asked twice the rate that it has just had with 8 clients, at fixed times whatever it
does. Answers that come later are waited for. posed lets 16 images wait and refuses more. The peers have no limit; they
are measured again with one of 16 (Triton counts those in progress apart).

{over}

## Memory and start

Resident memory of all processes of a server after all of the above; from start to the first answer, median of {starts}.

{memory}

## Are the answers right?

ADD: the corners of the object's box are off by less than a tenth of its diameter in the mean (of the symmetric link,
from the nearest of its poses). An object without an answer counts as wrong. The last column is of all answers, also
those for half-hidden objects and for what is none: how many of them are wrong.

{accuracy}

## What this does not show

- One machine, one size of images, small networks. Where networks are large, they alone decide.
- The settings of the peers were chosen in short rounds, the defaults of posed over a long time.
- GPUs. There Triton has backends of its own.
- A p99 here is of some hundred requests. Start times are those with warm files.
"""

TRITON = """\
- **Triton, OpenVINO**: the same estimator behind NVIDIA Triton (`nvidia-pytriton` 0.7.0, on the CPU) instead of
  FastAPI. PyPI's Triton has the Python backend alone, so the networks run as before; Triton does HTTP and the queue."""
NO_TRITON = "- NVIDIA Triton (`nvidia-pytriton`) cannot be installed here."
NOISE = ", so ratios count and not rates"
TITLES = {"samples": "The three samples", "split": "{}, objects of which 70 % or more are visible"}


def write(args, results):
    picture = args.page.with_suffix(".svg")
    plot(results, picture)
    args.page.write_text(text(args, results, picture.name))


def text(args, results, picture):
    names = list(results["four"])
    triton = results["best"]["Triton, OpenVINO"]
    return PAGE.format(
        minutes=(results["ended"] - results["began"]) / 60,
        cores=results["cores"],
        rounds=args.rounds,
        seconds=args.seconds,
        before=results["load_before"][0],
        noise=NOISE if results["load_before"][0] > 0.5 else "",
        fastapi=version("fastapi"),
        uvicorn=version("uvicorn"),
        onnxruntime=version("onnxruntime"),
        opencv=version("opencv-python-headless"),
        triton=TRITON if "Triton, OpenVINO" in names else NO_TRITON,
        triton_setting=f" Triton has: {triton}." if "Triton, OpenVINO" in names else "",
        choices=choices(results),
        picture=picture,
        four=rates(results["four"], names),
        four_latency=latencies(results["four"], names),
        four_cpu=processors(results["four"], names),
        one=rates(results["one"], names),
        one_latency=latencies(results["one"], names),
        overload=args.overload,
        over=overload(results["over"]),
        starts=len(results["starts_s"]["posed"]),
        memory=table(
            ["", "memory, MiB", "start, s"],
            [[n, f"{results['rss_mib'][n]:.0f}", f"{np.median(results['starts_s'][n]):.1f}"] for n in names],
        ),
        accuracy=accuracy(args, results["accuracy"]),
    )


def table(head, rows):
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def choices(results):
    tried, rows = results["choices"], []
    for choice in tried["FastAPI, floats"]:
        row = [choice]
        for name, of in tried.items():
            cell = ""
            if choice in of:
                one, eight = of[choice]["rates"]
                cell = f"{one:.1f} / {eight:.1f}; {np.mean(of[choice]['cpu_ms']):.0f}; {of[choice]['rss_mib']:.0f}"
            row.append(f"**{cell}**" if results["best"][name] == choice else cell)
        rows.append(row)
    return table(["setting", *tried], rows)


def rates(loads, names):
    rows, bad = [], []
    for clients in loads["posed"]:
        of = {name: np.array([load["rate"] for load in loads[name][clients]]) for name in names}
        row = [clients, *(f"{np.median(of[name]):.1f}" for name in names)]
        rows.append(row + [f"**{np.median(of['posed'] / of[peer]):.2f}**" for peer in names[1:]])
    for name in names:
        count = sum(len(load["refused"]) + load["others"] for of in loads[name].values() for load in of)
        bad += [f"{name} {count}"] * (count > 0)
    note = f"\n\nRequests without an answer: {', '.join(bad)}." if bad else ""
    return table(["clients", *names, *(f"posed / {peer}" for peer in names[1:])], rows) + note


def latencies(loads, names):
    rows = []
    for clients in loads["posed"]:
        of = [np.concatenate([load["answered"] for load in loads[name][clients]]) for name in names]
        rows.append([clients, *map(spread, of)])
    return table(["clients", *names], rows)


def processors(loads, names):
    rows = []
    for clients in loads["posed"]:
        of = [[load["cpu_ms"] for load in loads[name][clients]] for name in names]
        rows.append([clients, *(f"{np.median(times):.0f}" for times in of)])
    return table(["clients", *names], rows)


def overload(loads):
    rows = []
    for name, load in loads.items():
        answered, refused = load["answered"], load["refused"]
        share = len(refused) / (len(answered) + len(refused) + load["others"])
        late = f"{np.percentile(refused, 99):.0f}" if refused else ""
        rates = [f"{load['asked']:.1f}", f"{load['rate']:.1f}"]
        rows.append([name, *rates, spread(answered), f"{100 * share:.0f} %", late, str(load["others"])])
    head = ["", "asked/s", "answered/s", "answers, p50 / p99, ms", "refused", "refusals, p99, ms", "failed"]
    return table(head, rows)


def accuracy(args, results):
    head = ["", "objects", "answered", "rotation, median (deg)", "translation, median (mm)", "5°5cm %", "ADD %"]
    parts = []
    for what, scores in results.items():
        rows = []
        for name, score in scores.items():
            degrees, millimetres = np.array(score["degrees"]), np.array(score["millimetres"])
            row = [name, str(score["views"]), str(score["found"])]
            row += [f"{np.median(degrees):.2f}", f"{np.median(millimetres):.1f}"]
            row.append(f"{100 * np.mean((degrees < 5) & (millimetres < 50)):.1f}")
            row.append(f"{100 * np.mean(np.array(score['corners']) < 0.1):.1f}")
            rows.append([*row, f"{100 * np.mean(score['wrong']):.1f}"])
        named = args.split_name[:1].upper() + args.split_name[1:]
        parts.append(TITLES[what].format(named) + ":\n\n" + table([*head, "answers that are wrong, %"], rows))
    return "\n\n".join(parts)


def spread(values):
    return f"{np.median(values):.0f} / {np.percentile(values, 99):.0f}" if len(values) else ""


def plot(results, path):
    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "posed"
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    for name, loads in results["four"].items():
        clients = [int(count) for count in loads]
        of = [[load["rate"] for load in loads[count]] for count in loads]
        axes.fill_between(clients, *np.percentile(of, (25, 75), axis=1), color=COLOURS[name], alpha=0.15, linewidth=0)
        axes.plot(clients, np.median(of, axis=1), "o-", color=COLOURS[name], label=name)
    axes.set_xscale("log", base=2)
    axes.set_xticks(clients, [str(count) for count in clients])
    axes.set(xlabel="clients", ylabel="images/s, four objects", ylim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(path, metadata={"Date": None})
