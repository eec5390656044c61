"""Boards to print, in millimetres: a ring of tags around a free middle for the object, or a ChArUco board."""

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from ..bop import DatasetError
from .tags import DEFAULT_FAMILY, FAMILIES

PAPERS = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
MARGIN_MM = 9.0
"""Most printers leave this much white."""
CAPTION_MM = 7.0
GAP = 0.25
"""White between tags, of their side: detectors need a cell and a half."""
CELLS_ACROSS = 6
MIN_FREE_CELLS = 2
CHARUCO_FAMILY = "aruco-5x5"
CHARUCO_SQUARES_ACROSS = 8
MARKER_OF_SQUARE = 0.72
POINTS_PER_MM = 72 / 25.4
RULER_MM = 100.0


@dataclass
class Sheet:
    """Black rectangles (x, y, w, h from the top left) and lines of text (x, baseline, size, words)."""

    width: float
    height: float
    rectangles: list[tuple[float, float, float, float]] = field(default_factory=list)
    texts: list[tuple[float, float, float, str]] = field(default_factory=list)
    tags: int = 0


def draw_tag(sheet: Sheet, family: str, tag: int, x: float, y: float, side: float) -> None:
    """Its black square starts at (x, y)."""
    dictionary = cv2.aruco.getPredefinedDictionary(FAMILIES[family])
    if tag >= len(dictionary.bytesList):
        raise DatasetError(f"{family} has {len(dictionary.bytesList)} tags; the board needs tag {tag}")
    cells = dictionary.markerSize + 2
    black = cv2.aruco.generateImageMarker(dictionary, tag, cells) < 128
    cell = side / cells
    for row in range(cells):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], black[row], [0]]).astype(int)))
        for start, end in zip(edges[::2], edges[1::2]):
            sheet.rectangles.append((x + start * cell, y + row * cell, (end - start) * cell, cell))
    sheet.tags += 1


def tag_board(paper: str, tag_mm: float | None, first: int, family: str = DEFAULT_FAMILY, rings: int = 1) -> Sheet:
    width, height = PAPERS[paper]
    across, down = width - 2 * MARGIN_MM, height - 2 * MARGIN_MM - CAPTION_MM
    side = tag_mm or round(across / (CELLS_ACROSS + (CELLS_ACROSS - 1) * GAP))
    pitch = side * (1 + GAP)
    columns, rows = int((across + side * GAP) // pitch), int((down + side * GAP) // pitch)
    if min(columns, rows) < 2 * rings + MIN_FREE_CELLS:
        raise DatasetError(
            f"tags of {side:g} mm leave no free middle on {paper}: give a smaller --tag-mm or larger paper"
        )
    sheet = Sheet(width, height)
    # To the edges of the paper: the wider the board, the better the poses.
    steps = (across - side) / (columns - 1), (down - side) / (rows - 1)
    for row in range(rows):
        for column in range(columns):
            if min(row, column, rows - 1 - row, columns - 1 - column) < rings:
                x, y = MARGIN_MM + column * steps[0], MARGIN_MM + row * steps[1]
                draw_tag(sheet, family, first + sheet.tags, x, y, side)
    words = f"posed board, {family} {first} to {first + sheet.tags - 1}, tag side {side:g} mm if printed at 100 %"
    caption(sheet, words)
    return sheet


def charuco_board(paper: str, legacy: bool, first: int) -> Sheet:
    """`legacy`: as OpenCV before 4.6 and calib.io do it: with an even number of rows, a marker at the top left."""
    width, height = PAPERS[paper]
    across, down = width - 2 * MARGIN_MM, height - 2 * MARGIN_MM - CAPTION_MM
    square = np.floor(across / CHARUCO_SQUARES_ACROSS)
    columns, rows = CHARUCO_SQUARES_ACROSS, int(down // square)
    sheet = Sheet(width, height)
    inset = square * (1 - MARKER_OF_SQUARE) / 2
    marker_first = legacy and rows % 2 == 0
    for row in range(rows):
        for column in range(columns):
            x, y = MARGIN_MM + column * square, MARGIN_MM + row * square
            if (row + column) % 2 == marker_first:
                sheet.rectangles.append((x, y, square, square))
            else:
                side = square * MARKER_OF_SQUARE
                draw_tag(sheet, CHARUCO_FAMILY, first + sheet.tags, x + inset, y + inset, side)
    side = square * MARKER_OF_SQUARE
    words = f"posed ChArUco {columns}x{rows}, {CHARUCO_FAMILY}, squares {square:g} mm, tag side {side:.2f} mm at 100 %"
    caption(sheet, words)
    return sheet


def caption(sheet: Sheet, words: str) -> None:
    bottom = sheet.height - MARGIN_MM
    sheet.rectangles += [(MARGIN_MM, bottom - 0.6, RULER_MM, 0.6)]
    sheet.rectangles += [(MARGIN_MM + end, bottom - 2.4, 0.3, 2.4) for end in (0, RULER_MM - 0.3)]
    sheet.texts.append(
        (MARGIN_MM, bottom - 3.2, 2.6, f"{words}. The bar is {RULER_MM:g} mm long: measure it, and a tag.")
    )


def rasterise(sheet: Sheet, px_per_mm: int) -> np.ndarray:
    """Grey, 8 bits, without the texts."""
    fine = np.full((round(sheet.height * px_per_mm), round(sheet.width * px_per_mm)), 255, np.uint8)
    for x, y, w, h in sheet.rectangles:
        left, top, right, bottom = (round(value * px_per_mm) for value in (x, y, x + w, y + h))
        fine[top:bottom, left:right] = 0
    return fine


def as_svg(sheet: Sheet) -> str:
    """All black cells are one path, so that no viewer shows seams between them."""
    cells = "".join(f"M{x:.4f} {y:.4f}h{w:.4f}v{h:.4f}h{-w:.4f}z" for x, y, w, h in sheet.rectangles)
    texts = "".join(
        f'<text x="{x:.2f}" y="{y:.2f}" font-size="{size}" font-family="Helvetica, Arial, sans-serif">{words}</text>'
        for x, y, size, words in sheet.texts
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{sheet.width:g}mm" height="{sheet.height:g}mm" '
        f'viewBox="0 0 {sheet.width:g} {sheet.height:g}"><rect width="100%" height="100%" fill="#fff"/>'
        f'<path d="{cells}"/>{texts}</svg>\n'
    )


def as_pdf(sheet: Sheet) -> bytes:
    """One page (PDF 1.4), viewers being told not to fit it to the paper."""
    scale, up = POINTS_PER_MM, sheet.height
    cells = [
        f"{x * scale:.4f} {(up - y - h) * scale:.4f} {w * scale:.4f} {h * scale:.4f} re"
        for x, y, w, h in sheet.rectangles
    ]
    texts = [
        f"BT /F1 {size * scale:.2f} Tf {x * scale:.2f} {(up - y) * scale:.2f} Td ({words}) Tj ET"
        for x, y, size, words in sheet.texts
    ]
    content = "\n".join([*cells, "f", *texts]).encode("ascii")
    box = f"[0 0 {sheet.width * scale:.4f} {sheet.height * scale:.4f}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
        "/Resources << /Font << /F1 << /Type /Font /Subtype /Type1 /BaseFont /Helvetica >> >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
    ]
    out, offsets = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, 1):
        offsets.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    trailer = b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, len(out))
    return out + b"xref\n0 %d\n0000000000 65535 f \n%s" % (len(objects) + 1, table) + trailer


def write_sheet(sheet: Sheet, path: Path) -> None:
    suffix = path.suffix.lower()
    if suffix not in (".pdf", ".svg"):
        raise DatasetError(f"{path}: the board is written as .pdf or .svg")
    path.write_bytes(as_pdf(sheet) if suffix == ".pdf" else as_svg(sheet).encode())
