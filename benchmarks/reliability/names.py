"""Camera names with a special meaning in file systems, HTML, spreadsheets or terminals."""

from pathlib import Path

import numpy as np

from benchmarks.reliability.material import Material
from benchmarks.reliability.tally import Tally
from catfree._run._result_folder import draw_pictures, read_results, write_results
from catfree._run._run import RunOutcome

SETS = {
    "path traversal": ("../../evil", "/etc/passwd", "a/../b", ".."),
    "folders": ("hall/a", "hall_a", "hall\\a", "hall:a"),
    "HTML": ("<script>alert(1)</script>", "&amp;", '"onload="x', "<img src=x>"),
    "CSV": ("=1+1", "a,b", 'a"b', "a;b"),
    "Markdown": ("|a|b|", "[x](y)", "# a", "`a`"),
    "control characters": ("a\nb", "a\tb", "\x1b[31m", "\x7f"),
    "TOML": ('a"]', "a\\", "[cam_1]", "a = 1"),
    "COLMAP": ("a b", " a", "# a", "a  b"),
    "formulas": ("lobby$a_b_c$", "$$", "$\\frac{1}", "a^b_c"),
    "other scripts": ("大厅", "здание", "قاعة", "🎥"),
    "alike on some file systems": ("a", "A", "ａ", "a "),
    "long": tuple("x" * 218 + end for end in "abcd"),
    "longer": tuple("y" * 767 + end for end in "abcd"),
    "long scripts": tuple("厅" * 200 + end for end in "abcd"),
    "reserved": ("CON", "nul", "aux.txt", "-rf"),
    "hidden": (".a", "..a", "...", "."),
}


def odd_names(tally: Tally, folder: Path, *, pictures: bool) -> None:
    """Write and read a result with each set of names.

    Args:
        tally: counts the outcomes.
        folder: an empty folder to work in.
        pictures: whether to draw pictures, too.
    """
    m = Material(0, cameras=4)
    scene, boxes, found = m.scene, m.detections, m.localization
    for number, (what, names) in enumerate(SETS.items()):
        root = folder / str(number) / "deep" / "result"
        outcome = RunOutcome(found, boxes, scene, None, names, np.arange(8))

        def act(root: Path = root, outcome: RunOutcome = outcome) -> object:
            write_results(root, outcome, pictures=False)
            back = read_results(root)
            if pictures:
                draw_pictures(root / "p", found, scene, camera_names=outcome.camera_names)
            return back

        row = "names of cameras"
        tally.attempt(row, act, detail=what, same=lambda back, names=names: back[2] == tuple(names))
        outside = [p for p in (folder / str(number)).rglob("*") if p.is_file()]
        outside = [p for p in outside if root not in p.parents]
        page = root / "report.html"
        if outside or (page.exists() and "<script>alert(1)" in page.read_text()):
            tally.count(row, "loss", f"{what}: {outside or 'raw HTML'}")
        if len(list((root / "boxes").glob("*"))) != len(names):
            tally.count(row, "loss", f"{what}: not one file of boxes per camera")
