"""The view in one file: made from the sources beside it, in our colours, asking nobody; reports, however long."""

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

from twohands.skeleton import PARENTS, ROOT
from twohands.visualization import view_page
from twohands.visualization.palette import _SHADES, HAND_COLOURS
from twohands.visualization.view_page import ClipReport, live_page, view_policy, view_script

VIEW = Path(__file__).resolve().parents[2] / "view"


def numbers(name: str) -> list[float]:
    """The numbers of a constant of view/src/skeleton.ts."""
    source = (VIEW / "src/skeleton.ts").read_text(encoding="utf-8")
    (value,) = re.findall(rf"const {name}\b[^=]*= ([^;]+);", source)
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", value)]


def test_the_bundle_was_made_from_these_sources():
    """`.ci/view.sh` makes it again and compares; this says without npm that somebody forgot to."""
    digest = hashlib.sha256()
    for path in [
        *(VIEW / name for name in ("build.mjs", "package-lock.json", "tsconfig.json")),
        *sorted((VIEW / "src").iterdir()),
    ]:
        name = path.relative_to(VIEW).as_posix()
        digest.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    assert f"sources sha256 {digest.hexdigest()} */" in view_script()[:200], "run npm ci && npm run build in view/"


def test_the_bundle_is_small_and_whole():
    script = view_script()
    assert 300_000 < len(script.encode()) < 750_000
    assert "</script" not in script.lower() and "Three.js Authors" in script


def test_no_package_of_the_lock_file_names_a_registry():
    assert "http" not in (VIEW / "package-lock.json").read_text(encoding="utf-8")


def test_bones_and_colours_are_those_of_the_pictures():
    assert numbers("PARENTS") == list(PARENTS) and numbers("ROOT") == [ROOT]
    assert numbers("HAND_COLOURS") == [value for colour in HAND_COLOURS for value in colour]
    assert numbers("SHADES") == list(_SHADES)


def test_nothing_but_the_view_may_run_or_be_asked():
    report, live = view_policy(live=False), view_policy(live=True)
    assert report.startswith("default-src 'none'; script-src 'sha256-") and "connect" not in report
    assert live == f"{report}; connect-src 'self'"


def test_what_the_page_is_told_cannot_end_its_element():
    page = live_page({"camera": "</script><script>alert(1)</script>"})
    assert page.count("</script>") == 2 and "alert(1)" in page


def written(folder: Path, count: int, **options) -> str:
    lines = [json.dumps({"version": 2, "source": "</script>"})]
    lines += [json.dumps({"index": index, "time_s": index / 10}) for index in range(count)]
    (folder / "hands.jsonl").write_text("\n".join(lines) + "\n")
    with ClipReport(folder, folder / "hands.jsonl", "a < b", options.get("size"), 25.0) as report:
        for index in range(count if "size" in options else 0):
            report.write(np.full((*options["size"][::-1], 3), 40 * index % 255, np.uint8), index / 10)
    return (folder / "report.html").read_text(encoding="utf-8")


def shown(page: str) -> list[dict]:
    (lines,) = re.findall(r'<script id="lines"[^>]*>\n(.*?)</script>', page, flags=re.DOTALL)
    return [json.loads(line) for line in lines.splitlines()]


def test_a_report_holds_the_lines(tmp_path):
    page = written(tmp_path, 4)
    header, *frames = shown(page)
    assert header["source"] == "</script>" and [frame["index"] for frame in frames] == [0, 1, 2, 3]
    assert "<title>a &lt; b - twohands</title>" in page and 'id="film"' not in page
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hands.jsonl", "report.html"]


def test_a_long_clip_is_shown_in_steps(tmp_path, monkeypatch):
    monkeypatch.setattr(view_page, "MAX_FRAMES", 4)
    assert [frame["index"] for frame in shown(written(tmp_path, 9))[1:]] == [0, 3, 6]


def test_a_report_holds_a_small_film_unless_that_is_too_large(tmp_path, monkeypatch):
    pytest.importorskip("av")
    page = written(tmp_path, 3, size=(1280, 720))
    (film,) = re.findall(r'<script id="film"[^>]*>([^<]*)</script>', page)
    assert len(film) > 100
    monkeypatch.setattr(view_page, "MAX_FILM_BYTES", 10)
    assert 'id="film"' not in written(tmp_path, 3, size=(1280, 720))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hands.jsonl", "report.html"]
