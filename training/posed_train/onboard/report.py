"""The report of a bundle: one HTML file that says how good an object's net is, what it was trained on, what helps."""

import base64
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from . import overlays, plots
from .expect import expect
from .judged import NEES_MEDIAN, Judged, Judgement
from .project import Item, Project
from .reference import Reference
from .weak import advice

STYLE = Path(__file__).with_name("report.css")
WORST = 8
NEES_95 = 12.59
"""Below it are 95 % of true covariances."""


def report(
    project: Project, item: Item, found: Judgement, reference: Reference | None, served: dict | None = None
) -> str:
    """`served` is what `posed evaluate --without-truth` says of the held-out photos, if it was asked."""
    name = escape(item.name)
    parts = [
        f"<h1>{name}</h1>",
        introduction(found, served),
        key_figures(found, item, served),
        section("What to improve", improve(found)),
        section("Accuracy in held-out photos", accuracy(found, served)),
        section("What to expect at which distance", distances(found)),
        section("The worst held-out photos", worst(found, item)),
        section("Photos", photos(project, found)),
        section("Training", training(found)),
        section("The object's frame", frame(item, reference)),
        section("What this cannot see", blind_spots()),
    ]
    head = (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name}: how good it is</title>\n<style>\n{STYLE.read_text()}</style>\n</head>\n<body>\n"
    )
    return head + "\n".join(parts) + "\n</body>\n</html>\n"


def section(title: str, content: str) -> str:
    return f"<h2>{escape(title)}</h2>\n{content}"


def introduction(found: Judgement, served: dict | None) -> str:
    count = len(found.held_out)
    whose = (
        "The figures below are of the whole service; the tables say what the network alone sees at one look."
        if spread_of(served)
        else "All figures are of the network alone, at one look. A server looks several times, and does better: "
        "<code>export --posed PROGRAM</code> tells how much."
    )
    return (
        f'<p class="note">{count} of {len(found.views)} photos were held out from training. The object stood still, so '
        "every photo must tell the same place for it: how far a photo's pose lies from what the other photos say is "
        f"its error, known without any measuring device. {whose}</p>"
    )


def spread_of(served: dict | None) -> dict | None:
    return (served or {}).get("spread_of_ok") or (served or {}).get("spread_of_all")


def key_figures(found: Judgement, item: Item, served: dict | None) -> str:
    held_out = found.held_out
    agreeing = [one for one in held_out if one.deviation.agrees]
    tiles = [(f"{len(agreeing)} of {len(held_out)}", "held-out photos agree")]
    if spread := spread_of(served):
        tiles += [
            (f"{number(spread['rotation_deg']['median'])}°", "rotation, median"),
            (f"{number(1000 * spread['translation_m']['median'])} mm", "place, median"),
        ]
    elif agreeing:
        tiles += [
            (f"{quantile(held_out, 'degrees', 0.5)}°", "rotation, median"),
            (f"{quantile(held_out, 'millimetres', 0.5)} mm", "place, median"),
        ]
    if item.size_mm:
        tiles.append((" × ".join(f"{side:.0f}" for side in item.size_mm) + " mm", f"size ({escape(item.solid)})"))
    tiles.append((f"{len(found.views)}", "photos"))
    return (
        '<div class="key">' + "".join(f"<div><strong>{a}</strong><span>{b}</span></div>" for a, b in tiles) + "</div>"
    )


def quantile(photos: Sequence[Judged], what: str, share: float) -> str:
    """Of all photos: one without a pose is a wrong one."""
    values = np.sort([abs(getattr(one, what)) for one in photos])
    value = values[min(len(values) - 1, int(share * len(values)))] if len(values) else np.inf
    return number(value)


def number(value: float) -> str:
    """Two digits are enough; beyond a thousand only "no pose" is left to say."""
    if not np.isfinite(value):
        return "no pose"
    return f"{value:.1f}" if abs(value) < 100 else f"{value:.0f}"


def improve(found: Judgement) -> str:
    told = (re.sub("`(.+?)`", r"<code>\1</code>", escape(one)) for one in advice(found))
    return "<ul>\n" + "\n".join(f"<li>{one}</li>" for one in told) + "\n</ul>"


def table(head: Sequence[str], rows: Sequence[Sequence[str]], quiet: Sequence[bool] = ()) -> str:
    """The first column is of words, the others of numbers."""
    lines = ["<table>", "<tr>" + "".join(cell("th", k, text) for k, text in enumerate(head)) + "</tr>"]
    for k, row in enumerate(rows):
        style = ' class="quiet"' if k < len(quiet) and quiet[k] else ""
        lines.append(f"<tr{style}>" + "".join(cell("td", column, text) for column, text in enumerate(row)) + "</tr>")
    return "\n".join([*lines, "</table>"])


def cell(tag: str, column: int, text: str) -> str:
    kind = ' class="number"' if column else ""
    return f"<{tag}{kind}>{escape(text)}</{tag}>"


def accuracy(found: Judgement, served: dict | None) -> str:
    held_out = found.held_out
    if not held_out:
        return "<p>No photo was held out.</p>"
    kinds = {"all": held_out}
    kinds["from above 50°"] = [one for one in held_out if one.elevation_deg >= 50]
    kinds["from 25° to 50°"] = [one for one in held_out if 25 <= one.elevation_deg < 50]
    kinds["from below 25°"] = [one for one in held_out if one.elevation_deg < 25]
    kinds["partly hidden"] = [one for one in held_out if one.view.visible_fraction < 0.9]
    head = ["photos", "count", "agree", "rotation °, median", "90 %", "place mm, median", "90 %", "along the ray mm"]
    rows = [
        [
            kind,
            f"{len(some)}",
            f"{sum(one.deviation.agrees for one in some)}",
            *(quantile(some, "degrees", share) for share in (0.5, 0.9)),
            *(quantile(some, "millimetres", share) for share in (0.5, 0.9)),
            quantile(some, "depth_mm", 0.5),
        ]
        for kind, some in kinds.items()
        if some
    ]
    parts = [table(head, rows), plot("errors over distance and height", plots.errors(found))]
    if not found.network.trusted:
        parts.append(covariances(held_out, found.network.widened))
    if served is not None:
        parts.append(by_posed(served))
    return "\n".join(parts)


def covariances(held_out: Sequence[Judged], widened: dict[str, float] | None) -> str:
    nees = [one.nees for one in held_out if one.deviation.agrees]
    if not nees:
        return ""
    within = np.mean(np.array(nees) < NEES_95)
    return (
        f"<p>Covariances of the solver: the median of the normalised squared errors (NEES) of the photos that agree is "
        f"<strong>{np.median(nees):.1f}</strong>; {NEES_MEDIAN} if they were true, more where poses scatter more than "
        f"they say. {within:.0%} lie within the 95 % ellipsoid.{corrected(widened)}</p>"
    )


def corrected(widened: dict[str, float] | None) -> str:
    if widened is None:
        return ""
    return (
        " So the service multiplies their standard deviations, by what these photos say of them: "
        f"{widened['depth']:.1f} times along the ray, {widened['lateral']:.1f} across it, {widened['rotation']:.1f} in "
        "rotation. In other light or at other distances poses may scatter more."
    )


def by_posed(served: dict) -> str:
    """What the whole service makes of the same photos, the detector included."""
    spread = spread_of(served)
    rows = [
        ["photos", f"{served['images']}"],
        ["answers", f"{served['answers']}"],
        ["with status ok", f"{served['ok']}"],
        ["ok, but in disagreement", f"{served['ok_disagreeing']}"],
    ]
    if spread:
        rows += [
            ["rotation °, median / 90 %", both(spread["rotation_deg"])],
            ["place mm, median / 90 %", both(spread["translation_m"], 1000)],
            ["depth mm, median / 90 %", both(spread["depth_m"], 1000)],
            ["NEES, median", f"{spread['nees_median']:.1f}"],
            ["within the 95 % ellipsoid", f"{spread['within_95']:.0%}"],
        ]
    warnings = "".join(f"<li>{escape(text)}</li>" for text in served.get("warnings", []))
    return (
        "<p>The same photos through the whole service, with the detector (<code>posed evaluate --without-truth</code>):"
        f"</p>\n{table(['', ''], rows)}" + (f"<ul>{warnings}</ul>" if warnings else "")
    )


def both(quantiles: dict, scale: float = 1) -> str:
    return f"{number(scale * quantiles['median'])} / {number(scale * quantiles['p90'])}"


def distances(found: Judgement) -> str:
    rows = expect(found)
    if not rows:
        return "<p>Too few photos agree to tell.</p>"
    head = ["distance", "object, px", "rotation °", "across mm", "depth mm", ""]
    cells = [
        [
            f"{row.distance_m:.2f} m",
            f"{row.side_px:.0f}",
            number(row.degrees),
            number(row.lateral_mm),
            number(row.depth_mm),
            "" if row.photographed else "extrapolated",
        ]
        for row in rows
    ]
    focal = found.views[0].camera_matrix[0, 0]
    return (
        table(head, cells, quiet=[not row.photographed for row in rows])
        + f'<p class="note">Medians, with this camera (focal length {focal:.0f} px). With another one look at the '
        "second column: what counts is how large the object is in the image. Extrapolated rows follow from the "
        "geometry; whether the net knows such views is another question: photograph at the distances that you need.</p>"
    )


def worst(found: Judgement, item: Item) -> str:
    ranked = sorted(found.held_out, key=lambda one: (-one.degrees if np.isfinite(one.degrees) else -1e9, one.name))
    figures = [
        f'<figure><img alt="" src="{inline(overlays.picture(found, item, one), "jpeg")}">'
        f"<figcaption>{escape(one.name)}: {caption(one)}</figcaption></figure>"
        for one in ranked[:WORST]
    ]
    return (
        '<p class="note">Red, with axes: what the net sees. Green: where the other photos put the object.</p>\n'
        '<div class="sheet">' + "\n".join(figures) + "</div>"
    )


def caption(one: Judged) -> str:
    if not one.deviation.compared:
        return "no pose"
    words = f"{number(one.degrees)}°, {number(one.millimetres)} mm; from {one.distance_m:.2f} m, "
    words += f"{one.elevation_deg:.0f}° high"
    return words + (f", {one.view.visible_fraction:.0%} visible" if one.view.visible_fraction < 0.95 else "")


def photos(project: Project, found: Judgement) -> str:
    parts = []
    for scene, seen in found.seen.items():
        views = found.of_scene(scene)
        sides = [max(view.box[2:]) for view in views]
        source = next((one for one in project.sources if one.get("scene") == scene), {})
        rows = [
            ["photos", f"{len(views)}"],
            ["camera poses by", str(source.get("by", "the dataset"))],
            ["directions with photos", f"{seen.share:.0%}"],
            ["distance, m", span(seen.distance_m, 2)],
            ["height, degrees", span(seen.elevation_deg, 0)],
            ["object, px", span(sides, 0)],
            ["photos with a mask", f"{sum(view.mask_path is not None for view in views)}"],
            ["photos in which a part is hidden", f"{sum(view.visible_fraction < 0.9 for view in views)}"],
        ]
        title = f"<h3>Scene {escape(scene)}</h3>" if len(found.seen) > 1 else ""
        picture = plot("directions of the photos", plots.directions(found, scene))
        parts.append(f"{title}{table(['', ''], rows)}\n{picture}")
    note = '<p class="note">Seen from above: the middle looks straight down on the object, the rim level at it.</p>'
    return "\n".join([*parts, note])


def span(values: Sequence[float], digits: int) -> str:
    return " / ".join(f"{f(values):.{digits}f}" for f in (np.min, np.median, np.max)) + " (least, median, most)"


def training(found: Judgement) -> str:
    result = found.result
    words = (
        f"<p>Network <code>{escape(result.network)}</code>, {result.steps} steps; the net of step {result.best_step} "
        "did best on held-out photos and is the one in the bundle.</p>"
    )
    curves = plots.curves(found.run)
    return words + (plot("curves of the training", curves) if curves else "")


def frame(item: Item, reference: Reference | None) -> str:
    axes = "Its origin is the middle of the object's box, z points up as the object stood, x along the longer side."
    if item.symmetries:
        axes += f" It looks the same after these turns: {escape(', '.join(item.symmetries))}."
    if reference is None:
        return f"<p>{axes} There is no reference: tie the network to a frame by <code>posed calibrate</code>.</p>"
    sigmas = np.sqrt(np.diag(reference.offset.covariance))
    residuals = np.array(reference.residuals)
    return (
        f"<p>{axes}</p><p>The reference is the mean over {sum(reference.inliers)} of {len(reference.inliers)} photos, "
        f"known to {np.degrees(np.linalg.norm(sigmas[3:])):.2f}° and {1000 * np.linalg.norm(sigmas[:3]):.2f} mm; a "
        f"single photo lies {np.median(residuals[:, 0]):.1f}° and {np.median(residuals[:, 1]):.1f} mm from it in the "
        "median.</p>"
    )


def blind_spots() -> str:
    return (
        "<p>What all photos share: a wrong scale (the measured side of a tag), a wrong frame. Rooms, lights and "
        "cameras that are not in the photos.</p>"
    )


def plot(words: str, content: bytes) -> str:
    return f'<img class="plot" alt="{escape(words)}" src="{inline(content, "png")}">'


def inline(content: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
