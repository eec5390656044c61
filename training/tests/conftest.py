"""A tiny rendered data set, made once for all tests."""

from pathlib import Path

import pytest

MODELS = Path(__file__).parents[1] / "demo" / "models"


@pytest.fixture(scope="session")
def rendered(tmp_path_factory) -> Path:
    from posed_train.render.dataset import render_dataset
    from posed_train.render.objects import load_objects
    from posed_train.render.rasteriser import Rasteriser

    root = tmp_path_factory.mktemp("data")
    render_dataset(Rasteriser, load_objects(MODELS), root / "train", scenes=4, views=4)
    return root
