"""Everything from rendering to the exported networks, on a tiny set."""

import json
from dataclasses import replace

import cv2
import numpy as np
import onnx
import pytest
import torch

from posed_train import (
    augment,
    bop,
    cli,
    config,
    crops,
    data,
    detector,
    efficientnet,
    export,
    exported,
    familiar,
    network,
    quantize,
    registration,
    train,
)
from tests.conftest import MODELS

CUBE = config.KeypointConfig(
    name="cube", obj_id=1, photoreal="train", network="lite", held_out_scenes=1, min_visible=0.3, steps=70
)
SIZE = network.Lite.input_size


def test_registration_needs_relative_poses_only(rendered):
    """Another object frame gives the same targets: the object poses cancel."""
    views = bop.read_views(rendered / "train", 1, min_visible=0.3)
    first = registration.register(views, "object", seed=3)
    elsewhere = np.eye(4)
    elsewhere[:3, :3], elsewhere[:3, 3] = registration.random_rotation(9), [0.3, -0.2, 1.0]
    moved = [bop.View(**{**view.__dict__, "camera_from_object": view.camera_from_object @ elsewhere}) for view in views]
    second = registration.register(moved, "object", seed=3)
    assert first.placed.keys() == second.placed.keys() == set(range(len(views)))
    for index, pose in first.placed.items():
        np.testing.assert_allclose(pose, second.placed[index], atol=1e-9)
    np.testing.assert_allclose(first.keypoints, second.keypoints, atol=1e-9)


def test_keypoints_surround_the_object(rendered):
    views = bop.read_views(rendered / "train", 1, min_visible=0.9)
    placed = registration.register(views, "object", seed=3)
    centre = placed.placed[0][:3, 3]
    assert np.linalg.norm(centre - views[0].camera_from_object[:3, 3]) < 0.01
    assert 0.05 < placed.size_m < 0.11  # the cube's sides are 54 mm, its diagonal 94


def test_the_axis_that_points_up_is_the_objects(rendered):
    views = data.Views(replace(CUBE, up=[0.6, 0, 0.8]), rendered)
    ends = 0.001 * np.outer([-1, 1], [0.6, 0, 0.8])
    for view, targets in zip(views.all, views.targets(list(range(6)))):
        ((start, end),) = registration.project(view.camera_matrix[None], view.camera_from_object[None], ends)
        expected, found = end - start, crops.axis_in_image(targets[0], views.heights)
        lean = np.degrees(np.arccos(expected @ found / np.linalg.norm(expected) / np.linalg.norm(found)))
        assert lean < 6, "but for perspective"
    with pytest.raises(ValueError, match="length 1"):
        replace(CUBE, up=[1, 1, 0])


def test_of_equal_orientations_the_upright_one_is_learned_whose_front_is_seen(rendered):
    half_turns = [np.diag([*signs, 1]).ravel().tolist() for signs in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    settings = replace(CUBE, symmetries_discrete=half_turns, up=[1, 0, 0], front=[0, 0, 1])
    views = data.Views(settings, rendered)
    indices = list(range(6))
    for view, both in zip(views.all, views.targets_in_front(indices)):
        axes = [crops.axis_in_image(one, views.heights) for one in both]
        assert len(axes) == 2 and axes[0] @ axes[1] < 0
        for one in both:
            _, rvec, tvec = cv2.solvePnP(views.registration.keypoints, one, view.camera_matrix, None)
            assert (cv2.Rodrigues(rvec)[0] @ views.front) @ tvec < 0
    rng = np.random.default_rng(2)
    whole = data.Data(settings, rendered, views)
    _, learned = whole.batch(20, augment.Augmenter([], rng, whole.input_size, views.heights), rng)
    assert learned.shape[:2] == (20, 1)
    assert all(crops.axis_in_image(one.numpy(), views.heights)[1] <= 0 for one in learned[:, 0])
    with pytest.raises(ValueError, match="right angles"):
        replace(settings, front=[0.8, 0, 0.6])


def test_missing_files_are_named(tmp_path):
    scene = tmp_path / "000000"
    scene.mkdir()
    (scene / "scene_gt_info.json").write_text("{}")
    with pytest.raises(bop.DatasetError, match=r"scene_gt\.json"):
        bop.read_views(tmp_path, 1)


def test_unknown_settings_are_named(tmp_path):
    path = tmp_path / "train.toml"
    path.write_text('name = "cube"\nobj_id = 1\nphotoreal = "train"\nlearningrate = 1\n')
    with pytest.raises(ValueError, match="learningrate"):
        config.load(path, config.KeypointConfig)


def test_trains_resumes_and_exports(rendered, tmp_path):
    run = tmp_path / "run"
    views = data.Views(CUBE, rendered)
    patches = data.Data(CUBE, rendered, views)
    trainer = train.Trainer(CUBE, views.registration.keypoints, None)
    rng = np.random.default_rng(0)
    vary = augment.Augmenter([], rng, SIZE)
    losses = [trainer.component_step(patches.batch(16, vary, rng)) for _ in range(60)]
    assert np.mean(losses[-5:]) < np.mean(losses[:5]) - 0.5

    run.mkdir()
    trainer.save(run / "checkpoint.pt")
    net = train.train(CUBE, rendered, run).net
    assert (run / "log.csv").read_text().splitlines()[1].startswith("70,")  # went on from step 60
    assert (run / "curves.png").stat().st_size > 10_000 and (run / "sheet.png").stat().st_size > 10_000

    out = tmp_path / "models" / "cube"
    identity = {"name": "cube", "obj_id": 1}
    # Raises where ONNX Runtime and PyTorch differ.
    export.export_keypoints(net, views, out, identity, {})
    manifest = json.loads((out / "object.json").read_text())
    assert manifest["model_sha256"] == export.sha256(out / "keypoints.onnx")
    assert manifest["second_look"]["up"] == [0, 0, 1]
    stored = export.session(out / "keypoints.onnx")
    assert [output.name for output in stored.get_outputs()] == list(export.KEYPOINT_OUTPUTS)
    crops = np.stack([familiar.closest_crop(views, index, SIZE) for index in range(6)])
    noise = rng.integers(0, 256, crops.shape, np.uint8)
    known, unknown = (stored.run(["unfamiliarity"], {"image": images})[0] for images in (crops, noise))
    assert 0.3 < known.mean() < 3 and unknown.min() > 2 * known.max()
    parameters = sum(value.numel() for value in net.parameters())
    assert (out / "keypoints.onnx").stat().st_size < 1.2 * parameters
    assert len(manifest["covariance_scale"]) == 8 and min(manifest["covariance_scale"]) > 0
    crops = np.zeros((3, SIZE, SIZE, 3), np.uint8)
    keypoints, covariances, peaks = export.predictor(out / "keypoints.onnx").run(crops)
    assert keypoints.shape == (3, 8, 2) and covariances.shape == (3, 8, 2, 2) and peaks.shape == (3, 8)
    # What others are to compare with.
    parity = json.loads((out / "parity.json").read_text())
    crops = cv2.imread(str(out / "parity.png"), cv2.IMREAD_COLOR_RGB).reshape(-1, SIZE, SIZE, 3)
    again = export.predictor(out / "keypoints.onnx").run(crops)[0]
    np.testing.assert_allclose(again, parity["keypoints_px"], atol=parity["tolerance_px"])
    assert np.ptp(again, axis=0).max() > 1, "the crops differ, and so do their keypoints"

    small = tmp_path / "int8" / "cube"
    assert "computes in 8 bits" in quantize.quantize(out, small, rendered / "train")
    kinds = lambda folder: {node.op_type for node in onnx.load(folder / "keypoints.onnx").graph.node}  # noqa: E731
    assert "QuantizeLinear" in kinds(small) - kinds(out)
    near = export.predictor(small / "keypoints.onnx").run(crops)[0]
    stated = json.loads((small / "parity.json").read_text())
    distance = np.median(np.linalg.norm(near - np.array(stated["keypoints_px"]), axis=-1))
    assert 0 < distance <= stated["median_tolerance_px"]
    float_weights, weights = (exported.read_weights(folder / "keypoints.onnx") for folder in (out, small))
    assert weights.keys() == float_weights.keys()
    for name, value in weights.items():
        np.testing.assert_allclose(value, float_weights[name], rtol=0, atol=value.abs().max() / 250, err_msg=name)
    assert json.loads((small / "object.json").read_text())["model_sha256"] == export.sha256(small / "keypoints.onnx")
    with pytest.raises(bop.DatasetError, match="no images"):
        quantize.quantize_keypoints(out, [])


def test_a_trained_net_is_a_start_for_more_keypoints_and_for_the_detector(rendered, tmp_path):
    views = data.Views(CUBE, rendered)
    first = train.Trainer(CUBE, views.registration.keypoints, None)
    first.save(tmp_path / "checkpoint.pt")
    more = replace(CUBE, keypoint_shape="rhombic-dodecahedron")
    keypoints = data.Views(more, rendered).registration.keypoints
    assert np.allclose(keypoints[:8], views.registration.keypoints)
    started = train.Trainer(more, keypoints, tmp_path / "checkpoint.pt").model.state_dict()
    for name, value in first.average.state_dict().items():
        assert torch.equal(started[name][: len(value)] if value.ndim else started[name], value), name
    settings = config.DetectorConfig(["cube"], [1], "train", "", "", network="lite", steps=1, batch=1)
    encoder = detector.Trainer(settings, tmp_path / "checkpoint.pt").model.backbone.encoder.state_dict()
    assert all(torch.equal(value, started[f"design.encoder.{name}"]) for name, value in encoder.items())
    with pytest.raises(ValueError, match='not a checkpoint of a keypoint net with network = "lite0"'):
        detector.Trainer(replace(settings, network="lite0"), tmp_path / "checkpoint.pt")
    with pytest.raises(ValueError, match=r"another network.*design\.head\.bias"):
        train.start_from(first.model, {k: v for k, v in first.average.state_dict().items() if "head" not in k})


def test_frozen_parts_keep_their_convolutions(rendered, tmp_path):
    views = data.Views(CUBE, rendered)
    keypoints, start = views.registration.keypoints, tmp_path / "checkpoint.pt"
    first = train.Trainer(CUBE, keypoints, None)
    first.save(start)
    settings = replace(CUBE, frozen=["encoder.stages.3"])
    trainer = train.Trainer(settings, keypoints, start)
    patches, rng = data.Data(settings, rendered, views), np.random.default_rng(0)
    for _ in range(3):
        trainer.component_step(patches.batch(8, augment.Augmenter([], rng, SIZE), rng))
    before, after = dict(first.average.named_parameters()), dict(trainer.average.named_parameters())
    kept = {name for name, value in after.items() if torch.equal(value, before[name])}
    assert kept == {name for name, value in after.items() if ".encoder.stages.3." in name and value.ndim == 4}
    with pytest.raises(ValueError, match="no such part"):
        train.Trainer(replace(CUBE, frozen=["stages.3"]), keypoints, start)
    with pytest.raises(ValueError, match="--init"):
        train.Trainer(settings, keypoints, None)


def test_the_pretrained_encoder_learns_slowly_or_not_at_all(rendered):
    held = ["encoder.stem", "encoder.stages.0", "encoder.stages.1"]
    settings = replace(CUBE, network="lite0", frozen=held, frozen_statistics=True, encoder_rate=0.1)
    views = data.Views(settings, rendered)
    trainer = train.Trainer(settings, views.registration.keypoints, None)
    before = {name: value.clone() for name, value in trainer.model.design.state_dict().items()}
    fresh = efficientnet.Encoder()
    fresh.load_imagenet()
    assert all(torch.equal(value, before[f"encoder.{name}"]) for name, value in fresh.state_dict().items())
    patches, rng = data.Data(settings, rendered, views), np.random.default_rng(0)
    for _ in range(2):
        trainer.component_step(patches.batch(2, augment.Augmenter([], rng, SIZE), rng))
    slow, fast = (group["lr"] for group in reversed(trainer.optimizer.param_groups))
    assert slow == pytest.approx(0.1 * fast) and fast > 0
    kept = {name for name, value in trainer.model.design.state_dict().items() if torch.equal(value, before[name])}
    encoder = {name for name in before if name.startswith("encoder.")}
    expected = {name for name in encoder if name.startswith(tuple(held)) or "running" in name or "num_batches" in name}
    assert kept == expected
    with pytest.raises(ValueError, match="no encoder"):
        train.Trainer(replace(settings, network="paper", frozen=[]), views.registration.keypoints, None)


def test_the_pretrained_network_exports(rendered, tmp_path):
    settings = replace(CUBE, network="lite0")
    views = data.Views(settings, rendered)
    net = train.Trainer(settings, views.registration.keypoints, None).average
    # Raises where ONNX Runtime and PyTorch differ.
    export.export_keypoints(net, views, tmp_path, {"name": "cube", "obj_id": 1}, {})
    assert (tmp_path / "keypoints.onnx").stat().st_size < 4e6


@pytest.mark.parametrize("loss", ["pairwise", "registration"])
def test_the_papers_losses_go_down(rendered, loss):
    """From camera poses alone: every scene is a component."""
    settings = replace(CUBE, poses="camera", loss=loss, augmentation=0.0, held_out_scenes=9, held_out_every=99)
    views = data.Views(settings, rendered)
    trainer = train.Trainer(settings, views.registration.keypoints, None)
    rng = np.random.default_rng(0)
    vary = augment.Augmenter([], rng, SIZE)
    batch = data.Pairs(settings, views).batch(8, vary, rng)
    losses = [trainer.pairwise_step(batch) for _ in range(60)]
    # On the same few pairs again and again: over many the losses stay on a plateau for long.
    assert np.isfinite(losses).all() and np.mean(losses[-5:]) < 0.8 * np.mean(losses[:5])


def test_a_net_first_learns_where_its_keypoints_are(rendered):
    """Then how far they are off, and how far apart."""
    settings = replace(CUBE, steps=100, distance_weight=0.4, scale_weight=2.0)
    trainer = train.Trainer(settings, data.Views(settings, rendered).registration.keypoints, None)
    distance, scale = zip(*(trainer.weights() for trainer.step in range(101)))
    assert scale[0] == 0 and 0 < distance[0] < 0.4 / 2
    assert (distance[-1], scale[-1]) == (0.4, 2.0)
    assert all(np.diff(distance) >= 0) and all(np.diff(scale) >= 0)


def test_the_network_of_the_paper_learns_and_exports(rendered, tmp_path):
    settings = replace(CUBE, network="paper", keypoint_shape="r-sphere", keypoint_count=5, batch=4)
    views = data.Views(settings, rendered)
    trainer = train.Trainer(settings, views.registration.keypoints, None)
    batches = train.load(*[data.Data(settings, rendered, views)] * 2, settings, trainer, workers=2)
    losses = [trainer.component_step(next(batches)) for _ in range(12)]
    assert np.mean(losses[-3:]) < np.mean(losses[:3])
    export.export_keypoints(trainer.model, views, tmp_path, {"name": "cube", "obj_id": 1}, {})
    assert json.loads((tmp_path / "object.json").read_text())["input"]["size"] == 192
    exported = export.predictor(tmp_path / "keypoints.onnx")
    assert exported.run(np.zeros((1, 192, 192, 3), np.uint8))[0].shape == (1, 5, 2)


def test_batches_do_not_depend_on_the_workers(rendered):
    """Nor on where a training was stopped: step 5 is step 5."""
    views = data.Views(CUBE, rendered)
    patches = data.Data(CUBE, rendered, views)
    trainer = train.Trainer(CUBE, views.registration.keypoints, None)
    alone = train.load(patches, patches, CUBE, trainer, workers=0)
    trainer.step = 3
    shared = train.load(patches, patches, CUBE, trainer, workers=2)
    for _ in range(3):
        next(alone)
    for _ in range(4):
        for expected, found in zip(next(alone), next(shared)):
            assert torch.equal(expected, found)


def test_settings_that_cannot_be_are_named(rendered):
    for change, words in (({"loss": "magic"}, "magic"), ({"network": "huge"}, "huge"), ({"poses": "guess"}, "guess")):
        with pytest.raises(ValueError, match=words):
            train.train(replace(CUBE, **change), rendered, rendered / "nowhere")


def test_a_detector_from_imagenet_keeps_its_first_stages_and_statistics(rendered):
    settings = config.DetectorConfig(["cube"], [1], "train", "", "", batch=2)
    fresh = efficientnet.Encoder()
    fresh.load_imagenet()
    trainer = detector.Trainer(settings, None)
    samples = detector.read_samples(rendered / "train", [1])
    rng = np.random.default_rng(0)
    for _ in range(2):
        trainer.train_step(detector.draw([samples], [], 2, rng))
    before, after = fresh.state_dict(), trainer.model.backbone.encoder.state_dict()
    kept = {name for name, value in after.items() if torch.equal(value, before[name])}
    held = ("stem.", "stages.0.", "stages.1.")
    assert kept == {name for name in before if name.startswith(held) or "running" in name or "num_batches" in name}
    slow, fast = (group["lr"] for group in reversed(trainer.optimizer.param_groups))
    assert 0 < slow < fast
    with pytest.raises(ValueError, match="'paper': a detector has the encoder of lite0 or lite"):
        detector.Trainer(replace(settings, network="paper"), None)


def test_a_detector_sees_backgrounds_without_objects_and_boxes_that_stay_on_theirs(rendered):
    """Of one colour: the object alone is bright, so its box can be told by the pixels."""
    image = np.zeros((detector.HEIGHT, detector.WIDTH, 3), np.uint8)
    image[100:180, 200:320] = 255
    sample = detector.Sample(image, image[..., 0], np.array([[200.0, 100, 320, 180]]), np.zeros(1, int), np.ones(1))
    rng, empty = np.random.default_rng(1), 0
    for _ in range(40):
        (drawn,) = detector.draw([[sample]], [np.zeros((200, 300, 3), np.uint8)], 1, rng)
        assert drawn.image.shape == image.shape and drawn.image.dtype == np.uint8
        empty += not len(drawn.boxes)
        for x1, y1, x2, y2 in drawn.boxes.round().astype(int):
            inside = drawn.image[y1 + 4 : y2 - 4, x1 + 4 : x2 - 4].mean()
            assert inside > drawn.image[:, :, :].mean()
    assert 0 < empty < 20


def test_exported_detector_agrees_with_torchvision(rendered, tmp_path):
    settings = config.DetectorConfig(["cube", "link"], [1, 4], "train", "", "", steps=20, batch=2)
    model = detector.train(settings, rendered, tmp_path / "run")
    export.export_detector(model, settings.labels, tmp_path / "detector", {})
    image = detector.letterbox(cv2.imread(str(rendered / "train/000000/rgb/000000.jpg"), cv2.IMREAD_COLOR_RGB))[0]
    rows = export.session(tmp_path / "detector/detector.onnx").run(None, {"image": image[None]})[0][0]
    model.eval()
    expected = model(list(detector.to_tensor([image])))[0]
    assert len(rows) > 0
    best = rows[rows[:, 4].argmax()]
    k = expected["scores"].argmax()
    np.testing.assert_allclose(best[:4], expected["boxes"][k].detach().numpy(), atol=0.1)
    np.testing.assert_allclose(best[4], expected["scores"][k].item(), atol=1e-3)
    assert best[5] == expected["labels"][k].item()


def test_commands_train_and_export(rendered, tmp_path, monkeypatch):
    settings = tmp_path / "train.toml"
    settings.write_text(
        'name = "motor"\nobj_id = 3\nphotoreal = "train"\nvalidation = "train"\nmodels = "models"\n'
        "held_out_scenes = 1\nmin_visible = 0.3\nsteps = 3\nbatch = 4\n"
    )
    if not (rendered / "models").exists():
        (rendered / "models").symlink_to(MODELS)
    arguments = ["--data", rendered, "--runs", tmp_path / "runs", "--models", tmp_path / "models", "--threads", 1]
    monkeypatch.setattr("sys.argv", ["posed-train", "keypoints", str(settings), *map(str, arguments)])
    cli.main()
    manifest = json.loads((tmp_path / "models/motor/object.json").read_text())
    assert manifest["name"] == "motor" and manifest["obj_id"] == 3
    assert "add_percent" in manifest["training"]["validation"]

    settings.write_text('name = "motor"\nobj_id = 9\nphotoreal = "train"\n')
    with pytest.raises(SystemExit, match="no usable view of object 9"):
        cli.main()
