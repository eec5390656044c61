"""One command from a labelled project to models; short, so that only the way is tested, not the accuracy."""

import json
import re

import numpy as np
import pytest
from conftest import TAG_MM, run

from posed_train import bop, data, export, train
from posed_train.bop import DatasetError
from posed_train.config import KeypointConfig
from posed_train.onboard import project as projects
from posed_train.onboard import training
from posed_train.onboard.symmetry import motions


def test_a_project_trains_without_settings(project, tmp_path, capsys):
    models = tmp_path / "models"
    words = ["train", project, "--models", models, "--steps", 2, "--detector-steps", 2, "--threads", 1]
    run(*words)
    for name in ("cube", "motor"):
        manifest = json.loads((models / name / "object.json").read_text())
        assert manifest["name"] == name and manifest["model_sha256"] == export.sha256(models / name / "keypoints.onnx")
        assert manifest["training"]["held_out"]["photos"] > 2
    assert json.loads((models / "detector/detector.json").read_text())["labels"] == ["cube", "motor"]
    printed = capsys.readouterr().out
    assert "held-out photos agree" in printed
    assert int(re.search(r"cube: (\d+) backgrounds", printed)[1]) > 70, "textures, and crops of the photos"
    assert (project / "runs/cube/sheet.png").exists()
    # It goes on from where it was: nothing is left to do.
    before = (project / "runs/cube/log.csv").read_text()
    run(*words)
    assert (project / "runs/cube/log.csv").read_text() == before


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
    assert len(views.registration.components) == 4 and views.held_out
    assert set(views.held_out) <= set(views.registration.placed)


def test_components_that_joined_stay_when_training_goes_on(rendered, tmp_path):
    views = data.Views(settings(), rendered)
    other = views.registration.components[1]
    pose = np.eye(4)
    pose[:3, 3] = 0.1, 0.2, 0.3
    views.registration.place(other, pose)
    train.write_joined(tmp_path / "joined.json", views)
    again = data.Views(settings(), rendered)
    assert not set(other.views) & set(again.registration.placed)
    train.read_joined(tmp_path / "joined.json", again)
    for index in other.views:
        np.testing.assert_allclose(again.registration.placed[index], views.registration.placed[index])
