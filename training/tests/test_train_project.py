"""One command from a labelled project to models; short, so that only the way is tested, not the accuracy."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import TAG_MM, run

from posed_train import bop, data, export, joined, stopping, train
from posed_train.augment import Augmenter
from posed_train.bop import DatasetError
from posed_train.config import KeypointConfig
from posed_train.onboard import project as projects
from posed_train.onboard import training
from posed_train.onboard.symmetry import motions


def test_a_project_trains_without_settings(project, tmp_path, capfd):
    """Both nets at once, where there are cores for it: each in a process of its own."""
    models = tmp_path / "models"
    words = ["train", project, "--models", models, "--steps", 2, "--detector-steps", 2, "--threads", 1]
    run(*words)
    for name in ("cube", "motor"):
        manifest = json.loads((models / name / "object.json").read_text())
        assert manifest["name"] == name and manifest["model_sha256"] == export.sha256(models / name / "keypoints.onnx")
        assert manifest["training"]["held_out"]["photos"] > 2
    manifest = json.loads((models / "detector/detector.json").read_text())
    assert manifest["labels"] == ["cube", "motor"] and manifest["training"]["network"] == "lite0"
    printed = capfd.readouterr().out
    assert re.search(r"step 2 of 2: loss \d+\.\d+; \d+ of \d+ held-out photos agree", printed)
    # What is weak, and what to do about it.
    assert "directions around the object have no photo" in printed and "(`posed-train add`)" in printed
    assert int(re.search(r"cube: (\d+) backgrounds", printed)[1]) > 70, "textures, and crops of the photos"
    assert (project / "runs/cube/sheet.png").exists()
    # It goes on from where it was: nothing is left to do.
    before = (project / "runs/cube/log.csv").read_text()
    run(*words)
    assert (project / "runs/cube/log.csv").read_text() == before
    with pytest.raises(SystemExit, match="network 'large': choose one of lite0,"):
        run(*words, "--network", "large")


def test_more_photos_are_a_scene_of_their_own(project, board_photos, drawn, tmp_path, capsys):
    """Photos of another day: under other names, labelled by themselves."""
    more = tmp_path / "more"
    more.mkdir()
    for name in board_photos.names:
        (more / f"B_{name}").write_bytes((board_photos.folder / name).read_bytes())
    before = (project / "train/000000/scene_gt.json").read_bytes()
    run("add", project, more, "--tag-mm", TAG_MM)
    assert "scene 000001 added" in capsys.readouterr().out
    boxes = {"cube": {"boxes": {f"B_{name}": box for name, box in drawn["cube"]["boxes"].items()}}}
    (tmp_path / "boxes.json").write_text(json.dumps(boxes))
    run("label", project, "--box", tmp_path / "boxes.json")
    views = bop.read_views(project / "train", 1)
    assert {view.scene for view in views} == {"000000", "000001"}
    assert (project / "train/000000/scene_gt.json").read_bytes() == before
    run("check", project, "--object", "cube")
    assert "in 2 components" in capsys.readouterr().out
    # A training goes on from that of the scenes before, in a folder of its own.
    settings = projects.load(project)
    out, start = training.run_folders(settings, settings.item("cube"), views)
    assert out == project / "runs/cube-2" and start is None
    (project / "runs/cube").mkdir(parents=True)
    (project / "runs/cube/checkpoint.pt").write_bytes(b"x")
    assert training.run_folders(settings, settings.item("cube"), views)[1] == project / "runs/cube/checkpoint.pt"
    with pytest.raises(SystemExit, match="no such folder"):
        run("add", project, tmp_path / "nowhere", "--tag-mm", TAG_MM)
    assert not (project / "train/000002").exists()


def test_projects_of_one_object_name_are_refused(project, tmp_path):
    with pytest.raises(SystemExit, match="two of one name"):
        run("train", project, project, "--models", tmp_path / "models")


def test_symmetries_are_turned_into_motions():
    assert motions([]) == []
    (half,) = motions(["z2"])
    np.testing.assert_allclose(np.reshape(half, (4, 4)), np.diag([-1, -1, 1, 1]), atol=1e-9)
    assert len(motions(["x2", "y2"])) == 3
    assert len(motions(["x4", "y4"])) == 23, "a cube's turns"
    assert len(motions(["z"])) == 23
    for wrong in ("w2", "z1", "2z", ""):
        with pytest.raises(DatasetError, match="half a turn"):
            motions([wrong])
    with pytest.raises(DatasetError, match="tell fewer"):
        motions(["x5", "y7"])


def settings(**more):
    return KeypointConfig(name="cube", obj_id=1, photoreal="train", poses="camera", backgrounds="", **more)


def test_scenes_that_are_placed_late_leave_views_to_hold_out(rendered):
    """Twice as many scenes as are held out, of which all but the largest are placed by the net."""
    views = data.Views(settings(held_out_scenes=2, held_out_every=2), rendered)
    assert len(views.registration.components) == 4
    placed = set(views.registration.placed)
    # Four views are all there is to learn from; of scenes that join, some are held out.
    assert not views.held_out
    for component in views.registration.components[1:]:
        views.registration.place(component, np.eye(4))
        views.hold_out_of(component.views, settings(held_out_every=2))
    assert len(views.held_out) == len(views.registration.placed) // 2
    assert not placed & set(views.held_out)


def many_scenes(rendered, out, views_each):
    """Twelve scenes and more: the rendered ones, again and again, with so many views each."""
    for number, count in enumerate(views_each):
        source, folder = rendered / f"train/{number % 4:06d}", out / f"train/{number:06d}"
        folder.mkdir(parents=True)
        (folder / "rgb").symlink_to(source / "rgb")
        for name in ("camera", "gt", "gt_info"):
            content = json.loads((source / f"scene_{name}.json").read_text())
            kept = {key: value for key, value in list(content.items())[:count]}
            (folder / f"scene_{name}.json").write_text(json.dumps(kept))
    return out


def test_the_largest_of_many_scenes_is_not_all_held_out(rendered, tmp_path):
    root = many_scenes(rendered, tmp_path, [2] * 11 + [4])
    views = data.Views(settings(held_out_every=2, min_visible=0.0), root)
    assert len(views.registration.placed) == 4, "the last scene, one of those that are held out where all are placed"
    assert len(views.held_out) < 4
    batch, _ = data.Data(settings(), root, views).batch(2, Augmenter([], np.random.default_rng(0), 160), RNG)
    assert len(batch) == 2


RNG = np.random.default_rng(1)


def test_pairs_are_trained_and_exported(rendered, tmp_path):
    """A net of pairs alone: all but one are placed late, or never. Nothing dies after hours."""
    root = many_scenes(rendered, tmp_path, [2] * 13)
    pairs = settings(steps=1, batch=2, network="lite", min_visible=0.0)
    trained = train.train(pairs, root, tmp_path / "run")
    assert len(trained.views.registration.placed) < len(trained.views.all) and not trained.views.held_out
    export.export_keypoints(trained.net, trained.views, tmp_path / "cube", {"name": "cube", "obj_id": 1}, {})
    manifest = json.loads((tmp_path / "cube/object.json").read_text())
    assert np.isfinite(manifest["covariance_scale"]).all() and min(manifest["covariance_scale"]) > 0


def test_components_that_joined_stay_when_training_goes_on(rendered, tmp_path):
    views = data.Views(settings(), rendered)
    other = views.registration.components[1]
    pose = np.eye(4)
    pose[:3, 3] = 0.1, 0.2, 0.3
    views.registration.place(other, pose)
    views.held_out = [other.views[0]]
    joined.write(tmp_path / "joined.json", views)
    again = data.Views(settings(), rendered)
    assert not set(other.views) & set(again.registration.placed)
    joined.read(tmp_path / "joined.json", again)
    for index in other.views:
        np.testing.assert_allclose(again.registration.placed[index], views.registration.placed[index])
    assert again.held_out == views.held_out, "what is learned from stays apart from what is not"


@pytest.fixture
def impatient(monkeypatch):
    """Nothing counts as a gain, and a training is over after a few steps without."""
    for name, value in (("GAIN", 1.0), ("LEAST_PATIENCE", 4), ("PATIENCE", 0.1), ("LEAST_COOL_DOWN", 4)):
        monkeypatch.setattr(stopping, name, value)
    monkeypatch.setattr(train, "CHECKPOINT_EVERY", 2)
    monkeypatch.setattr(train, "FIRST_SHEET", 1)


def test_a_training_ends_where_nothing_is_gained(rendered, tmp_path, impatient, capsys):
    tiny = KeypointConfig(
        name="cube", obj_id=1, photoreal="train", network="lite", batch=2, steps=60, min_visible=0.3, stops_itself=True
    )
    trained = train.train(tiny, rendered, tmp_path)
    printed = capsys.readouterr().out
    (first,) = map(int, re.findall(r"step (\d+): held-out photos gain no more", printed))
    assert trained.last == first + max(4, round(first / 4)) < 60
    assert re.search(r"step 2 of 60: loss \d+\.\d+; \d of \d held-out photos agree.*; .* left", printed), printed
    assert (tmp_path / "sheet.png").exists() and "spread_degrees" in (tmp_path / "log.csv").read_text()
    # It goes on from where it was: nothing is left to do, unless all steps are wanted.
    assert train.train(tiny, rendered, tmp_path).last == trained.last
    assert (
        train.train(replace(tiny, steps=trained.last + 2, stops_itself=False), rendered, tmp_path).last > trained.last
    )
