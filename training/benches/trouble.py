"""How often `ok` is wrong in images with trouble, for docs/benchmarks/trust.md: copies of a split with every trouble of
`posed-train corrupt` in five strengths, answered by `posed evaluate --detector`. Prints the table.

    .venv/bin/python -m benches.trouble SPLIT OUT --meshes MODELS OBJECT...

Copies and figures stay in OUT; what is there is not made again.
"""

import argparse
import json
import subprocess
from pathlib import Path

from benches.from_photos import POSED, ROOT, RUNTIME
from posed_train.corrupt import STRENGTHS, TROUBLES

LEAST_VISIBLE = 0.7


def figures(split: Path, meshes: Path, objects: list[str], kept: Path) -> list[dict]:
    """The views of a split that are visible enough, as `posed evaluate` answers them."""
    if not kept.exists():
        options = ["--split", split.resolve(), "--meshes", meshes.resolve(), "--detector", "--json", kept.resolve()]
        subprocess.run(
            [POSED, "evaluate", *objects, *options],
            check=True,
            stdout=subprocess.DEVNULL,
            env={"ORT_DYLIB_PATH": RUNTIME},
            cwd=ROOT,
        )
    return [view for view in json.loads(kept.read_text())["views"] if view["visible_fraction"] >= LEAST_VISIBLE]


def cells(views: list[dict]) -> tuple[str, ...]:
    """Right of all; the same, or one of the alternatives is; `ok` but wrong, of all answers and of the `ok` ones; right
    ones that are `ok`: in percent."""
    answers = [view for view in views if view["status"]]
    ok = [view for view in answers if view["status"] == "ok"]
    right = [view for view in answers if view["right"]]
    wrong = sum(not view["right"] for view in ok)
    return (
        percent(len(right), len(views)),
        percent(sum(view["right"] or view.get("right_alternative", False) for view in views), len(views)),
        percent(wrong, len(answers), 1),
        f"{percent(wrong, len(ok))} ({wrong}/{len(ok)})",
        percent(sum(view["status"] == "ok" for view in right), len(right)),
    )


def percent(part: int, whole: int, digits: int = 0) -> str:
    return f"{100 * part / whole:.{digits}f}" if whole else "-"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("split", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("objects", nargs="+")
    parser.add_argument("--meshes", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    head = (
        "trouble, from mild to strong",
        "right",
        "or an alternative",
        "`ok` but wrong",
        "of the `ok`",
        "right that are `ok`",
    )
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    plain = figures(arguments.split, arguments.meshes, arguments.objects, arguments.out / "none.json")
    print(f"| none | {' | '.join(cells(plain))} |")
    for trouble in TROUBLES:
        of_strength = []
        for strength in range(1, STRENGTHS + 1):
            copy = arguments.out / f"{trouble}-{strength}"
            if not copy.exists():
                command = [".venv/bin/posed-train", "corrupt", arguments.split, copy]
                command += ["--trouble", trouble, "--strength", str(strength)]
                subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            of_strength.append(cells(figures(copy, arguments.meshes, arguments.objects, copy.with_suffix(".json"))))
        print(f"| {trouble} | {' | '.join(', '.join(column) for column in zip(*of_strength))} |", flush=True)


if __name__ == "__main__":
    main()
