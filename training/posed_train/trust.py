"""What an answer can be trusted for: fits covariances that hold and a probability of being right, on views that the
network has not learned from.

`posed evaluate` answers the views, with everything that it does to an image: what is measured is the network, provider
and number of crops in use. What it says of each (`Evidence` in the service) is all that the fits see:

- covariances: factors of the solver's standard deviations along the ray, across it and of the rotation, each the
  exponential of a linear function of the evidence, by the likelihood of the errors;
- probability: logistic regression of "ADD(-S) is below a tenth of the diameter".

Objects share the weights and have a constant of their own. The weight of the ridge on both is chosen by the likelihood
of scenes that the fit has not seen.
"""

import json
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from .bop import DatasetError
from .export import write_manifest

MOST_WRONG = 0.02
"""Of the answers that are `ok` on the views of the fit."""
RANGE = 0.01, 0.99
"""Evidence beyond these quantiles of the views is taken for them."""
RIDGES = 1.0, 10.0, 100.0, 1000.0
CONSTANT_RIDGE = 1e9
FOLDS = 5
# Of a pose that is beyond, the covariance cannot tell: the probability should.
MAX_NEES_PER_DEGREE = 40.0
PARTS = {"depth": 1, "lateral": 2, "rotation": 3}
"""Of a pose's error, with their degrees of freedom."""


@dataclass
class Views:
    """Answers with their evidence `[V, E]`, within its ranges."""

    names: list[str]
    ranges: np.ndarray  # [E, 2]
    evidence: np.ndarray
    objects: np.ndarray  # [V] of str
    scenes: np.ndarray  # [V] of str
    right: np.ndarray  # [V] of bool
    nees: dict[str, np.ndarray]  # of the image's own covariance, by part
    total_nees: dict[str, np.ndarray]  # with that of the offset

    def only(self, which: np.ndarray) -> "Views":
        cut = {part: values[which] for part, values in self.nees.items()}
        total = {part: values[which] for part, values in self.total_nees.items()}
        objects, scenes = self.objects[which], self.scenes[which]
        return Views(self.names, self.ranges, self.evidence[which], objects, scenes, self.right[which], cut, total)


@dataclass
class Fit:
    """A linear function of evidence, `[E]`, with a constant for each object."""

    constants: dict[str, float]
    weights: np.ndarray

    def of(self, views: Views) -> np.ndarray:
        return np.array([self.constants[name] for name in views.objects]) + views.evidence @ self.weights

    def of_object(self, name: str, names: list[str]) -> dict:
        kept = {kind: round(float(weight), 5) for kind, weight in zip(names, self.weights) if abs(weight) > 1e-5}
        return {"constant": round(self.constants[name], 5), "weights": kept}


def evaluate(
    posed: Path, models: Path, reference: Path, names: list[str], splits: list[Path], meshes: Path
) -> list[dict]:
    """One line for each view that got a pose, by a service that trusts as the bare solver does."""
    with tempfile.TemporaryDirectory() as folder:
        bare = Path(folder) / "models"
        shutil.copytree(models, bare)
        for manifest in bare.glob("*/object.json"):
            entries = json.loads(manifest.read_text())
            entries.pop("trust", None)
            manifest.write_text(json.dumps(entries))
        figures = Path(folder) / "figures.json"
        command = [
            posed,
            "evaluate",
            *names,
            "--models",
            bare,
            "--reference",
            reference,
            "--meshes",
            meshes,
            "--detector",
        ]
        command += ["--visible", "0.1..1", "--json", figures]
        for split in splits:
            command += ["--split", split]
        if subprocess.run(command, stdout=subprocess.DEVNULL).returncode:
            raise OSError(f"{posed} evaluate failed, see above")
        return json.loads(figures.read_text())["views"]


def lines(kept: Path | None, make: Callable[[], list[dict]]) -> list[dict]:
    """Those of a file, or new ones, which go there."""
    if kept and kept.exists():
        return json.loads(kept.read_text())
    made = make()
    if kept:
        kept.write_text(json.dumps(made))
    return made


def store(manifest: Path, trust: dict) -> None:
    """In `object.json`, before `training`, in whose place the reader looks last."""
    entries = json.loads(manifest.read_text())
    training = entries.pop("training", None)
    entries["trust"] = trust
    write_manifest(manifest, entries | ({"training": training} if training is not None else {}))


def usable(lines: Iterable[dict]) -> list[dict]:
    """Those of views that got a pose."""
    return [line for line in lines if line["evidence"] and line["image_nees"] and line["nees"]]


def collect(lines: list[dict]) -> Views:
    """Of usable lines."""
    if not lines:
        raise DatasetError("no view got a pose: there is nothing to fit trust on")
    names = list(lines[0]["evidence"])
    evidence = np.array([[line["evidence"][name] or 0.0 for name in names] for line in lines])
    ranges = np.quantile(evidence, RANGE, axis=0).T
    return Views(
        names,
        ranges,
        np.clip(evidence, *ranges.T),
        np.array([line["object"] for line in lines]),
        np.array([line["scene"] for line in lines]),
        np.array([line["right"] for line in lines]),
        {part: np.array([line["image_nees"][part]["value"] for line in lines]) for part in PARTS},
        {part: np.array([line["nees"][part]["value"] for line in lines]) for part in PARTS},
    )


def factor_loss(log_factor: torch.Tensor, views: Views, part: str) -> torch.Tensor:
    """Negative log-likelihood of the errors of one part, less what does not depend on the factor.

    The reciprocal of an error squared in units of a covariance is that covariance in units of the error: the difference
    of those of the whole covariance and of the image's own is the offset's."""
    own = 1 / torch.tensor(views.nees[part]).clamp_min(1e-9)
    offset = (1 / torch.tensor(views.total_nees[part]).clamp_min(1e-9) - own).clamp_min(0)
    variance = own * torch.exp(2 * log_factor) + offset
    degrees = PARTS[part]
    return ((1 / variance).clamp_max(MAX_NEES_PER_DEGREE * degrees) + degrees * torch.log(variance)).mean() / 2


def probability_loss(logit: torch.Tensor, views: Views, _part: str) -> torch.Tensor:
    return torch.nn.functional.binary_cross_entropy_with_logits(logit, torch.tensor(views.right, dtype=torch.float64))


def fit(views: Views, part: str, ridge: float) -> Fit:
    loss = probability_loss if part == "probability" else factor_loss
    middle, spread = views.evidence.mean(0), views.evidence.std(0)
    spread = np.where(spread > 1e-6, spread, np.inf)
    objects = sorted(set(views.objects))
    own = (views.objects[:, None] == objects).astype(float)
    columns = torch.tensor(np.hstack([own, (views.evidence - middle) / spread]))
    parameters = torch.zeros(columns.shape[1] + 1, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([parameters], max_iter=300, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        value = loss(parameters[0] + columns @ parameters[1:], views, part)
        value = value + ridge / len(columns) * parameters[1:].square().sum()
        value.backward()
        return value

    optimiser.step(closure)
    common, *rest = parameters.detach().numpy()
    weights = np.array(rest[len(objects) :]) / spread
    constant = common - weights @ middle
    return Fit({name: float(constant + more) for name, more in zip(objects, rest)}, weights)


def loss_on(views: Views, part: str, found: Fit) -> float:
    loss = probability_loss if part == "probability" else factor_loss
    return float(loss(torch.tensor(found.of(views)), views, part))


def folds(views: Views) -> list[np.ndarray]:
    """Of views, by scene: views of one are alike, and those of its copies with some trouble."""
    scenes = sorted(set(views.scenes))
    place = {scene: index % min(FOLDS, len(scenes)) for index, scene in enumerate(scenes)}
    fold = np.array([place[scene] for scene in views.scenes])
    return [fold == index for index in sorted(set(fold))]


def choose(views: Views, part: str) -> tuple[float, float, float]:
    """The best ridge, its loss on scenes that were not fitted, and that of a constant alone."""

    def held_out(ridge: float) -> float:
        losses = [loss_on(views.only(fold), part, fit(views.only(~fold), part, ridge)) for fold in folds(views)]
        return float(np.average(losses, weights=[fold.sum() for fold in folds(views)]))

    by_ridge = {ridge: held_out(ridge) for ridge in (*RIDGES, CONSTANT_RIDGE)}
    best = min(by_ridge, key=by_ridge.get)
    return best, by_ridge[best], by_ridge[CONSTANT_RIDGE]


def probabilities(views: Views, found: Fit) -> np.ndarray:
    return 1 / (1 + np.exp(-found.of(views)))


def threshold(probability: np.ndarray, right: np.ndarray) -> float:
    """The least probability from which on at most `MOST_WRONG` of the answers are wrong."""
    order = np.argsort(-probability)
    wrong = np.cumsum(~right[order]) / np.arange(1, len(order) + 1)
    good = np.nonzero(wrong <= MOST_WRONG)[0]
    return float(probability[order][good[-1]]) if len(good) else 1.0


def held_out_probabilities(views: Views, ridge: float) -> np.ndarray:
    """Of each view by a fit that has not seen its scene."""
    found = np.zeros(len(views.right))
    for fold in folds(views):
        found[fold] = probabilities(views.only(fold), fit(views.only(~fold), "probability", ridge))
    return found


def fit_trust(views: Views, common: np.ndarray | None = None) -> tuple[dict[str, dict], dict]:
    """`trust` of each object's `object.json`, and figures of the fit. `common` are the views without special trouble:
    they settle the threshold (all, by default)."""
    common = np.ones(len(views.right), bool) if common is None else common
    chosen = {part: choose(views, part) for part in (*PARTS, "probability")}
    fits = {part: fit(views, part, ridge) for part, (ridge, *_) in chosen.items()}
    unseen = held_out_probabilities(views, chosen["probability"][0])
    ok_probability = round(threshold(unseen[common], views.right[common]), 4)
    ranges = {name: [round(float(end), 5) for end in ends] for name, ends in zip(views.names, views.ranges)}

    def of_object(name: str) -> dict:
        linear = {part: found.of_object(name, views.names) for part, found in fits.items()}
        probability = linear.pop("probability")
        return {
            "ranges": ranges,
            "covariance": linear,
            "probability": probability,
            "ok_probability": ok_probability,
        }

    ok, right = unseen[common] >= ok_probability, views.right[common]
    figures = {
        "views": len(views.right),
        "views of the threshold": len(right),
        "right": int(right.sum()),
        "ok": int(ok.sum()),
        "ok but wrong": int((ok & ~right).sum()),
        "right and ok": int((ok & right).sum()),
        "from": ok_probability,
        **{f"loss of {part}": (round(best, 3), round(alone, 3)) for part, (_, best, alone) in chosen.items()},
    }
    return {name: of_object(name) for name in sorted(set(views.objects))}, figures
