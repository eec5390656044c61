"""Printed boards: what a detector reads from the files."""

import re

import cv2
import numpy as np
import pytest

from posed_train import cli
from posed_train.onboard import tags


def run(monkeypatch, *arguments):
    monkeypatch.setattr("sys.argv", ["posed-train", *map(str, arguments)])
    cli.main()


def drawn(rectangles, width_mm, height_mm, px_per_mm=5):
    """Grey picture of black rectangles in millimetres."""
    image = np.full((round(height_mm * px_per_mm), round(width_mm * px_per_mm)), 255, np.uint8)
    for x, y, w, h in rectangles:
        left, top, right, bottom = np.round(np.array([x, y, x + w, y + h]) * px_per_mm + 0.01).astype(int)
        image[top:bottom, left:right] = 0
    return image


def read_svg(path):
    text = path.read_text()
    width, height = map(float, re.search(r'width="([\d.]+)mm" height="([\d.]+)mm"', text).groups())
    cells = re.findall(r"M([\d.]+) ([\d.]+)h([\d.]+)v([\d.]+)h-[\d.]+z", text)
    return [tuple(map(float, cell)) for cell in cells], width, height


def read_pdf(path):
    data = path.read_bytes()
    # The cross-reference table points at every object.
    start = int(re.search(rb"startxref\n(\d+)", data).group(1))
    assert data[start : start + 4] == b"xref"
    for number, offset in enumerate(re.findall(rb"(\d{10}) 00000 n", data[start:]), 1):
        assert data[int(offset) :].startswith(b"%d 0 obj" % number)
    width, height = (float(v) * 25.4 / 72 for v in re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data).groups())
    cells = (
        np.array([[float(v) for v in cell.split()[:4]] for cell in re.findall(rb"([-\d. ]+) re\n", data)]) * 25.4 / 72
    )
    cells[:, 1] = height - cells[:, 1] - cells[:, 3]
    return cells.tolist(), width, height


@pytest.mark.parametrize("paper", ["a4", "a3", "letter"])
@pytest.mark.parametrize(("suffix", "read"), [("svg", read_svg), ("pdf", read_pdf)])
def test_a_board_is_read_from_its_file_with_a_free_middle(tmp_path, monkeypatch, capsys, paper, suffix, read):
    out = tmp_path / f"board.{suffix}"
    run(monkeypatch, "board", out, "--paper", paper, "--first", 40, "--tag-mm", 24)
    image = drawn(*read(out))
    found = tags.find_tags(image)
    assert sorted(found.ids) == list(range(40, 40 + len(found)))
    assert f"{len(found)} tags" in capsys.readouterr().out
    sides = np.linalg.norm(found.corners - np.roll(found.corners, 1, axis=1), axis=-1) / 5
    assert abs(np.median(sides) - 24) < 0.4
    height, width = image.shape
    middle = image[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3]
    assert (middle == 255).all(), "room for the object"


@pytest.mark.parametrize("legacy", [False, True])
def test_a_charuco_board_is_opencvs(tmp_path, monkeypatch, legacy):
    out = tmp_path / "board.svg"
    run(monkeypatch, "board", out, "--paper", "letter", "--charuco", *(["--legacy"] if legacy else []))
    rectangles, width, height = read_svg(out)
    dictionary = cv2.aruco.getPredefinedDictionary(tags.FAMILIES["aruco-5x5"])
    rows = 10
    board = cv2.aruco.CharucoBoard((8, rows), 24, 24 * 0.72, dictionary)
    board.setLegacyPattern(legacy)
    corners, ids, *_ = cv2.aruco.CharucoDetector(board).detectBoard(drawn(rectangles, width, height))
    assert ids is not None and len(ids) == 7 * (rows - 1)
    assert len(corners) == len(ids)


def test_what_cannot_be_printed_is_said(tmp_path, monkeypatch):
    with pytest.raises(SystemExit, match="no free middle"):
        run(monkeypatch, "board", tmp_path / "board.pdf", "--tag-mm", 60)
    with pytest.raises(SystemExit, match=r"\.pdf or \.svg"):
        run(monkeypatch, "board", tmp_path / "board.png")
    with pytest.raises(SystemExit, match="587 tags"):
        run(monkeypatch, "board", tmp_path / "board.pdf", "--first", 580)
    assert not list(tmp_path.iterdir())
