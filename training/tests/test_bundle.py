"""Bundles of objects and their reports, made with the demo's net of the cube, which knows the cube on the board."""

import hashlib
import html.parser
import json
import re
import shutil
import tarfile
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from conftest import run
from scipy.spatial.transform import Rotation

from posed_train import bop
from posed_train.onboard import result as results
from posed_train.onboard.judged import read_network
from posed_train.onboard.reference import average, measure, of_photo
from posed_train.pnp import Solved, stepped

REPOSITORY = Path(__file__).parents[2]
POSED = REPOSITORY / "target/release/posed"


@pytest.fixture(scope="module")
def trained(labelled, tmp_path_factory) -> tuple[Path, Path]:
    """A project as if it had made the demo's net of the cube, and the folder of models."""
    root = tmp_path_factory.mktemp("trained")
    project, models = root / "cube", root / "models"
    shutil.copytree(labelled, project)
    for name in ("cube", "detector"):
        shutil.copytree(REPOSITORY / "models" / name, models / name)
    network = read_network(models / "cube")
    views = bop.read_views(project / "train", 1, 0.35)
    known = np.linalg.inv(measure(network, views).offset.object_from_keypoints)
    held_out = [[view.scene, view.image_id] for view in views[::3]]
    told = results.Result(network.manifest["model_sha256"], "lite0", 6000, 4800, held_out, known.tolist())
    (project / "runs/cube").mkdir(parents=True)
    (project / "runs/cube/result.json").write_text(json.dumps(asdict(told)))
    (project / "runs/cube/log.csv").write_text(
        "step,seconds,loss,spread_degrees,spread_mm\n250,9,6,20,40\n500,18,5,3,5\n"
    )
    return project, models


def export(trained, out, *words) -> Path:
    project, models = trained
    run("export", project, "--object", "cube", "--models", models, "--out", out, *words)
    return out / "cube.posed"


@pytest.fixture(scope="module")
def bundle(trained, tmp_path_factory) -> dict[str, bytes]:
    """Its files, in their order."""
    with tarfile.open(export(trained, tmp_path_factory.mktemp("out"))) as tar:
        return {entry.name: tar.extractfile(entry).read() for entry in tar}


def test_a_bundle_is_a_plain_tar_of_stated_files(trained, bundle, tmp_path):
    path = export(trained, tmp_path)
    first = path.read_bytes()
    assert export(trained, tmp_path / "again").read_bytes() == first, "the same object, the same bytes"
    with tarfile.open(path, "r:") as tar:
        entries = tar.getmembers()
    assert first[257:263] == b"ustar\0" and len(first) % 512 == 0
    assert all(e.isreg() and e.mode == 0o644 and (e.uid, e.gid, e.mtime) == (0, 0, 0) and not e.uname for e in entries)
    assert entries[0].name == "bundle.json"
    stated = json.loads(bundle["bundle.json"])
    assert (stated["format"], stated["version"], stated["name"]) == ("posed-bundle", 1, "cube")
    assert set(stated["files"]) == {entry.name for entry in entries[1:]}
    for name, entry in stated["files"].items():
        content = bundle[name]
        assert entry == {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    models = trained[1]
    for name in ("object.json", "keypoints.onnx", "parity.json", "parity.png"):
        assert bundle[name] == (models / "cube" / name).read_bytes()
    for name in ("detector.json", "detector.onnx"):
        assert bundle[f"detector/{name}"] == (models / "detector" / name).read_bytes()
    assert "Apache-2.0" in bundle["NOTICE"].decode()
    assert not list(tmp_path.glob(".*")), "nothing half-written"


def test_a_report_may_have_nothing_to_compare(trained, tmp_path):
    """As after a training that was stopped too early: of one held-out photo no other says where the object is."""
    project = tmp_path / "cube"
    shutil.copytree(trained[0], project)
    path = project / "runs/cube/result.json"
    told = json.loads(path.read_text())
    path.write_text(json.dumps(told | {"held_out": told["held_out"][:1]}))
    export((project, trained[1]), tmp_path / "out")
    assert "0 of 1" in (project / "report-cube.html").read_text()


def test_the_reference_is_the_boxs_frame_in_many_photos(trained, bundle):
    project, models = trained
    reference, network = json.loads(bundle["reference.json"]), read_network(models / "cube")
    assert reference["keypoint_model_sha256"] == network.manifest["model_sha256"]
    entries = reference["references"]
    assert len(entries) > 15 and sum(entry["inlier"] for entry in entries) > 0.8 * len(entries)
    assert {f"reference/{entry['image']}" for entry in entries} == {n for n in bundle if n.startswith("reference/")}
    offset = pose_of(reference["object_from_keypoints"])
    # What the net sees in any photo, carried by the offset, is where the box was put.
    views = bop.read_views(project / "train", 1)
    apart = []
    for view, solved in zip(views, network.solve(views)):
        found = solved.camera_from_keypoints @ np.linalg.inv(offset)
        apart.append(np.linalg.norm(found[:3, 3] - view.camera_from_object[:3, 3]))
    assert np.median(apart) < 0.004
    sigmas = np.sqrt(np.diag(reference["covariance"]))
    assert np.degrees(sigmas[3:]).max() < 1 and sigmas[:3].max() < 0.002


def pose_of(stated: dict) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(stated["rotation_xyzw"]).as_matrix()
    pose[:3, 3] = stated["translation_m"]
    return pose


def test_many_photos_tell_the_offset_better_than_one():
    """Each is off by its covariance, most along its ray; and one is wrong."""
    rng, true = np.random.default_rng(3), np.eye(4)
    true[:3, :3], true[:3, 3] = Rotation.from_euler("xyz", [20, -40, 70], degrees=True).as_matrix(), [0.01, 0.02, 0.03]
    covariance = np.diag([0.001, 0.001, 0.01, 0.03, 0.03, 0.02]) ** 2
    views, offsets = [], []
    for k in range(30):
        camera_from_object = np.eye(4)
        camera_from_object[:3, :3] = Rotation.random(rng=rng).as_matrix()
        camera_from_object[:3, 3] = 0, 0, 0.5
        view = bop.View("", "", k, Path(), None, np.eye(3), camera_from_object, np.eye(4), (0, 0, 1, 1), 1.0)
        seen = stepped(camera_from_object @ true, rng.multivariate_normal(np.zeros(6), covariance))
        if k == 7:
            seen = seen @ np.diag([-1.0, -1, 1, 1])
        views.append(view)
        offsets.append(of_photo(view, Solved(seen, covariance, 8)))
    found = average(views, offsets, np.eye(4)[None])
    assert [k for k, inlier in enumerate(found.inliers) if not inlier] == [7]
    error = np.linalg.norm(found.offset.object_from_keypoints[:3, 3] - true[:3, 3])
    assert error < 0.002 and np.sqrt(np.trace(found.offset.covariance[:3, :3])) < 0.002
    # With that half turn declared as a symmetry it is as good as the others.
    half_turn = true @ np.diag([-1.0, -1, 1, 1]) @ np.linalg.inv(true)
    assert all(average(views, offsets, np.stack([np.eye(4), half_turn])).inliers)
    with pytest.raises(bop.DatasetError, match="agree on where"):
        average(views[:3], [*offsets[6:8], turned(offsets[6])], np.eye(4)[None])


def turned(offset):
    quarter = np.eye(4)
    quarter[:3, :3] = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    return type(offset)(offset.object_from_keypoints @ quarter, offset.covariance)


class Page(html.parser.HTMLParser):
    def __init__(self, text: str):
        super().__init__()
        self.sources, self.words, self.open = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, "tags are closed in their order"

    def handle_data(self, data):
        self.words.append(data)


def test_the_report_says_how_good_it_is_in_one_file(trained, bundle):
    page = Page(bundle["report.html"].decode())
    text = " ".join(" ".join(page.words).split())
    assert not page.open and page.sources and all(source.startswith("data:image/") for source in page.sources)
    assert "10 of 10 held-out photos agree" in text and "53 × 53 × 54 mm" in text
    rotation, place = (float(re.search(rf"([\d.]+)({unit}) {words}", text)[1]) for unit, words in UNITS)
    assert 0.3 < rotation < 3 and 0.5 < place < 6
    for words in ("30 photos are few", "add some near IMG_", "extrapolated", "IMG_", "6000 steps", "step 4800"):
        assert words in text, words
    # Errors over directions, curves, directions, and the worst photos.
    assert len(page.sources) == 3 + 8
    assert (trained[0] / "report-cube.html").read_bytes() == bundle["report.html"]


UNITS = (("°", "rotation, median"), (" mm", "place, median"))


@pytest.mark.skipif(not POSED.exists(), reason="the program is not built (cargo build --release)")
def test_posed_adds_its_own_figures(trained, tmp_path, monkeypatch):
    monkeypatch.chdir(REPOSITORY)
    with tarfile.open(export(trained, tmp_path, "--posed", POSED)) as tar:
        text = tar.extractfile("report.html").read().decode()
    assert "with the detector" in text and "ok, but in disagreement" in text and "NEES, median" in text
    # What a server does comes first.
    words = " ".join(" ".join(Page(text).words).split())
    first, median = (
        re.search(pattern, words)[1] for pattern in (r"([\d.]+)° rotation", r"rotation °, median / 90 % ([\d.]+)")
    )
    assert first == median and "figures below are of the whole service" in words


def test_an_object_that_the_net_does_not_find_gets_no_reference(trained, tmp_path, capsys):
    """The motor, with the net of the cube."""
    project = Path(shutil.copytree(trained[0], tmp_path / "project"))
    models = tmp_path / "models"
    shutil.copytree(trained[1] / "cube", models / "motor")
    told = json.loads((project / "runs/cube/result.json").read_text()) | {"keypoints_from_object": None}
    (project / "runs/motor").mkdir()
    (project / "runs/motor/result.json").write_text(json.dumps(told))
    run("export", project, "--object", "motor", "--models", models, "--out", tmp_path)
    printed = capsys.readouterr().out
    assert "no reference: " in printed and "train longer" in printed and "no detector in" in printed
    with tarfile.open(tmp_path / "motor.posed") as tar:
        names = tar.getnames()
        text = tar.extractfile("report.html").read().decode()
    assert "reference.json" not in names and "detector/detector.onnx" not in names
    assert "do not agree with the others" in text and "There is no reference" in text


def test_what_cannot_be_exported_is_said(trained, tmp_path):
    project, models = trained
    words = ["export", project, "--object", "cube", "--out", tmp_path]
    with pytest.raises(SystemExit, match=r"object\.json: No such file.*posed-train train"):
        run(*words, "--models", tmp_path / "nowhere")
    other = Path(shutil.copytree(models, tmp_path / "other"))
    manifest = json.loads((other / "cube/object.json").read_text())
    (other / "cube/keypoints.onnx").write_bytes(b"another network")
    with pytest.raises(SystemExit, match=r"SHA-256 is not the one in object\.json"):
        run(*words, "--models", other)
    manifest["model_sha256"] = hashlib.sha256(b"another network").hexdigest()
    (other / "cube/object.json").write_text(json.dumps(manifest))
    with pytest.raises(SystemExit, match="not a network that `posed-train train"):
        run(*words, "--models", other)
    with pytest.raises(SystemExit, match="no object 'cup'"):
        run("export", project, "--object", "cup", "--models", models)
    with pytest.raises(SystemExit, match=r"--posed .*nowhere: No such file"):
        run(*words, "--models", models, "--posed", tmp_path / "nowhere")
    assert not list(tmp_path.glob("*.posed")) and not list(tmp_path.glob(".*"))
