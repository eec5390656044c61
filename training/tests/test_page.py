"""The page of `posed-train label`, driven in a browser."""

import json
import os
import re
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from browser import Browser
from conftest import box_of, whole_in

from posed_train import bop
from posed_train.onboard import project as projects
from posed_train.onboard.drawn import read_solid
from posed_train.onboard.label import read_scene, source_of
from posed_train.onboard.project import Item
from posed_train.onboard.solid import Solid, box_from_object

PICTURES = os.environ.get("POSED_PICTURES")
"""A folder, to be looked at by people."""


@pytest.fixture
def fresh(project) -> Path:
    """The project without what was drawn in it."""
    scene = project / "train/000000"
    (scene / "drawn.json").unlink()
    for name in ("gt", "gt_info"):
        path = scene / f"scene_{name}.json"
        path.write_text(json.dumps({key: [] for key in json.loads(path.read_text())}))
    return project


def serve(project: Path):
    words = ["from posed_train.cli import main; main()", "label", str(project)]
    served = subprocess.Popen([sys.executable, "-c", *words], stdout=subprocess.PIPE, text=True)
    return served, re.search(r"http://127\.0\.0\.1:\d+/", served.stdout.readline())[0]


@pytest.fixture
def address(fresh):
    served, url = serve(fresh)
    yield url
    served.terminate()
    served.wait()


@pytest.fixture
def browser():
    found = Browser()
    yield found
    found.close()


def picture(browser: Browser, name: str) -> None:
    if PICTURES:
        browser.picture(Path(PICTURES) / f"label-{name}.png")


class Page:
    """The page, by what a person does there."""

    def __init__(self, browser: Browser, url: str, photos):
        self.browser, self.photos = browser, photos
        browser.open(url)
        browser.until("document.querySelectorAll('.photo').length")

    def open(self, name: str) -> None:
        script = "[...document.querySelectorAll('.photo')].find((one) => one.innerText === arguments[0]).click();"
        self.browser.run(script, name)
        self.browser.until(f"document.querySelector('#photo-name').innerText.startsWith({json.dumps(name + ' ')})")

    @property
    def scale(self) -> float:
        """Pixels of the screen for one of the photo."""
        return self.browser.run("return document.querySelector('#photo').clientWidth;") / self.photos.width

    def drag(self, start, end) -> None:
        """Between places in the photo, pixels with (0, 0) at the corner of the first."""
        self.browser.drag("#photo", *(tuple(np.array(place) * self.scale) for place in (start, end)))

    def draw(self, name: str, index: int) -> None:
        """The box of an object in a photo."""
        self.open(name)
        x, y, w, h = box_of(self.photos.masks[self.photos.names.index(name)][index])
        self.drag((x, y), (x + w, y + h))

    def size(self) -> list[float]:
        return [float(self.browser.value(label)) for label in ("length", "width", "height")]


def test_a_box_drawn_in_two_photos_labels_all(browser, address, fresh, board_photos):
    page = Page(browser, address, board_photos)
    first, second, third = whole_in(board_photos, 0)[:3]
    names = [board_photos.names[k] for k in (first, second, third)]
    page.draw(names[0], 0)
    # One box is a guess, on the ground.
    browser.until("document.querySelector('#origin').innerText.includes('guess')")
    assert all(25 < side < 150 for side in page.size())
    page.draw(names[1], 0)
    browser.until("document.querySelector('#origin').innerText.startsWith('By 2 drawn boxes')")
    assert np.allclose(page.size(), 54.2, atol=9)
    browser.press("Draw a box")
    page.draw(names[2], 0)
    browser.until("document.querySelector('#origin').innerText.startsWith('By 3 drawn boxes')")
    picture(browser, "drawn")
    # It is seen in all others at once; one of them is bad, and the cube looks the same after quarters of a turn.
    bad = board_photos.names[whole_in(board_photos, 0)[4]]
    page.open(bad)
    browser.press("Bad photo")
    browser.choose("about z", "4")
    browser.press("Save and label all photos")
    done = browser.until("document.querySelector('.done')?.innerText")
    assert re.search(r"cube: 5\d\.\d x 5\d\.\d x 5\d\.\d mm \(box", done)
    saved = json.loads((fresh / "boxes-000000.json").read_text())
    assert set(saved["cube"]["boxes"]) == set(names) and saved["bad photos"] == [bad]
    item = projects.load(fresh).item("cube")
    assert item.symmetries == ["z4"] and np.allclose(item.size_mm, 54.2, atol=3)
    views = bop.read_views(fresh / "train", 1)
    photos = json.loads((fresh / "train/000000/photos.json").read_text())
    assert len(views) > 20 and bad not in {photos[str(view.image_id)] for view in views}
    # The box that is drawn is not what was measured.
    Page(browser, address, board_photos)
    browser.until("document.querySelector('#origin').innerText.includes('photos measured 5')")
    assert not browser.complaints()


def seen_in(fresh: Path, photo: str, solid: Solid, place) -> np.ndarray:
    """The pixel of a place in a solid (shares of its sides from its middle)."""
    scene = read_scene(fresh / "train/000000", source_of(projects.load(fresh), "000000"))
    frame = next(frame for frame in scene.frames if frame.name == photo)
    pose = solid.standing_from_box
    return frame.project((pose[:3, :3] @ (np.array(place) * solid.size) + pose[:3, 3])[None])[0] + 0.5


def saved_solid(fresh: Path) -> Solid:
    entry = json.loads((fresh / "boxes-000000.json").read_text())["cube"]
    return read_solid(entry, entry["solid"], "saved")


def test_edges_are_dragged_and_axes_named(browser, address, fresh, board_photos):
    page = Page(browser, address, board_photos)
    first, second = (board_photos.names[k] for k in whole_in(board_photos, 0)[:2])
    page.draw(first, 0)
    page.draw(second, 0)
    browser.until("document.querySelector('#origin').innerText.startsWith('By 2 drawn boxes')")
    for label, value in (("length", "80"), ("width", "60"), ("height", "50")):
        browser.fill(label, value)
    browser.until("document.querySelector('#origin').innerText.startsWith('Placed by hand')")
    browser.press("Save")
    browser.until("document.querySelector('#state').innerText.startsWith('saved')")
    before = saved_solid(fresh)
    assert np.allclose(before.size, [0.08, 0.06, 0.05])
    # An upper edge: the side below it and the top follow the mouse; what is across from them stays.
    page.open(second)
    taken = seen_in(fresh, second, before, [0.1, 0.5, 0.5])
    larger = Solid("box", before.base, before.yaw, before.size + np.array([0, 0.02, 0.015]))
    across = before.standing_from_box[:3, 1]
    larger = Solid("box", before.base + 0.01 * across, before.yaw, larger.size)
    page.drag(taken, seen_in(fresh, second, larger, [0.1, 0.5, 0.5]))
    picture(browser, "dragged")
    browser.press("Save")
    browser.until("document.querySelector('#state').innerText.startsWith('saved')")
    after = saved_solid(fresh)
    assert np.allclose(after.size, larger.size, atol=0.0015) and np.allclose(after.base, larger.base, atol=0.0015)
    assert after.yaw == pytest.approx(before.yaw, abs=1e-4)
    # The dot moves it on the board, the ring turns it.
    goal = Solid("box", after.base + np.array([0.03, -0.02, 0]), after.yaw, after.size)
    page.drag(*(seen_in(fresh, second, one, [0, 0, -0.5]) for one in (after, goal)))
    turned = Solid("box", goal.base, goal.yaw + 0.4, goal.size)
    page.drag(*(seen_in(fresh, second, one, [0.72, 0, -0.5]) for one in (goal, turned)))
    browser.press("Turn the axes by 90°")
    browser.choose("axis that points up", "-y")
    browser.choose("about y", "any")
    browser.press("Save")
    browser.until("document.querySelector('#state').innerText.startsWith('saved')")
    last = saved_solid(fresh)
    assert np.allclose(last.base, goal.base, atol=0.002) and np.allclose(last.size, goal.size[[1, 0, 2]], atol=1e-4)
    assert np.sin(last.yaw - turned.yaw - np.pi / 2) == pytest.approx(0, abs=0.03)
    entry = json.loads((fresh / "boxes-000000.json").read_text())["cube"]
    assert entry["up"] == "-y" and entry["symmetries"] == ["y"]
    # A step back, and what was saved is there again after a reload.
    browser.press("Undo")
    browser.until("document.querySelector('#state').innerText === 'not saved'")
    browser.press("Save")
    browser.until("document.querySelector('#state').innerText.startsWith('saved')")
    browser.open(address)
    browser.until("document.querySelectorAll('.photo').length")
    assert np.allclose(page.size(), 1000 * last.size, atol=0.06) and browser.value("axis that points up") == "-y"
    assert browser.value("about y") == "" and not browser.complaints()


def test_a_box_by_hand_becomes_frame_and_size(browser, address, fresh, board_photos):
    """Exactly as it was placed, with its axes as they were named."""
    page = Page(browser, address, board_photos)
    for k in whole_in(board_photos, 0)[:2]:
        page.draw(board_photos.names[k], 0)
    browser.until("document.querySelector('#origin').innerText.startsWith('By 2 drawn boxes')")
    browser.fill("height", "54.2")
    browser.choose("axis that points up", "x")
    browser.press("Save and label all photos")
    browser.until("document.querySelector('.done')?.innerText")
    picture(browser, "labelled")
    item, solid = projects.load(fresh).item("cube"), saved_solid(fresh)
    assert item.up == "x" and item.size_mm[0] == 54.2
    scene = read_scene(fresh / "train/000000", source_of(projects.load(fresh), "000000"))
    view = bop.read_views(fresh / "train", 1)[0]
    frame = next(frame for frame in scene.frames if frame.image_id == view.image_id)
    expected = frame.camera_from_standing @ solid.standing_from_object(item)
    np.testing.assert_allclose(view.camera_from_object, expected, atol=1e-6)
    up = frame.camera_from_standing[:3, 2]
    assert view.camera_from_object[:3, 0] @ up == pytest.approx(1)


def test_names_of_axes_are_turns():
    for up in projects.UPS:
        turn = box_from_object(up)[:3, :3]
        assert np.linalg.det(turn) == pytest.approx(1)
        axis = (-1 if up.startswith("-") else 1) * np.eye(3)["xyz".index(up[-1])]
        np.testing.assert_allclose(turn @ axis, [0, 0, 1])
    item = Item("mug", 1, up="y")
    Solid("box", np.zeros(3), 0.0, np.array([0.1, 0.2, 0.3])).describe(item)
    # y is up, z along the box's x, and x along its y.
    assert item.size_mm == [200.0, 300.0, 100.0]


def ask(url: str, path: str, body: bytes | None = None, **headers: str):
    request = urllib.request.Request(url.rstrip("/") + path, body, headers)
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def test_only_the_page_itself_is_answered(address, fresh):
    json_type = {"Content-Type": "application/json"}
    assert ask(address, "/api/project")[0] == 200
    assert ask(address, "/api/project", Host="evil.example")[0] == 403
    assert ask(address, "/api/save", b"{}", Origin="http://evil.example", **json_type)[0] == 403
    assert ask(address, "/api/save", b"{}", **{"Content-Type": "text/plain"})[0] == 400
    for path in ("/page/../drawn.py", "/page/%2e%2e/drawn.py", "/image/../../etc/passwd", "/nothing"):
        assert ask(address, path)[0] == 404
    assert ask(address, "/image/000000/99")[0] == 400
    before = sorted(path.name for path in fresh.iterdir())
    for body, words in (
        (b"{", "not valid JSON"),
        (b"[]", "a JSON object"),
        (b'{"scene": "7"}', "scene '7'"),
        (b'{"scene": "000000", "objects": {"cup": {}}}', "no object 'cup'"),
        (b'{"scene": "000000", "objects": {"cube": {"size_mm": [1, 2]}}}', "needs 3 numbers"),
        (b'{"scene": "000000", "objects": {}, "bad": ["IMG_99.jpg"]}', "no photo 'IMG_99.jpg'"),
    ):
        status, said = ask(address, "/api/save", body, **json_type)
        assert status == 400 and words in json.loads(said)["error"]
    assert sorted(path.name for path in fresh.iterdir()) == before, "nothing was saved"
