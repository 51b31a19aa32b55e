"""`twohands inspect` through the command line: table, contact sheet, exit codes."""

import os
from pathlib import Path

import cv2
import pytest
from tests.datasets import fakes

from twohands.cli.main import main
from twohands.formats import ego3dhands as fmt


def test_sound_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fakes.write_instance(tmp_path / "data" / "0")
    fakes.write_instance(tmp_path / "data" / "1", left=False)
    assert main(["inspect", str(tmp_path / "data"), "--out", str(tmp_path / "out"), "--count", "1"]) == 0
    printed = capsys.readouterr().out
    assert "both 1, left only 0, right only 1, none 0" in printed
    sheet = cv2.imread(str(tmp_path / "out" / "contact_sheet.png"))
    assert sheet is not None and sheet.shape == (270, 480, 3)


def test_problems_are_listed_and_exit_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("0", "1", "2"):
        fakes.write_instance(tmp_path / "data" / name)
    (tmp_path / "data" / "0" / fmt.DEPTH_FILE).write_bytes(b"")
    (tmp_path / "data" / "1" / fmt.IMAGE_FILE).write_bytes(b"GIF89a")
    arguments = ["inspect", str(tmp_path / "data"), "--out", str(tmp_path / "out")]
    assert main(arguments) == 1
    printed = capsys.readouterr().out
    assert "depth.png: zero bytes" in printed and "color_new.png: not a complete PNG file" in printed
    assert (tmp_path / "out" / "contact_sheet.png").is_file()  # of what is left
    assert main([*arguments, "--problems", "1"]) == 1
    assert "1 more problems" in capsys.readouterr().out


def test_nothing_to_inspect_exits_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert main(["inspect", str(tmp_path / "nowhere")]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 2
    assert "no instance found" in errors[0] and "no such folder" in errors[1]
    assert not (tmp_path / "out").exists()


def test_a_name_that_looks_like_markup_is_printed_as_it_is(tmp_path, capsys, monkeypatch) -> None:
    """Named case: of "set[abc]" the console showed "set"."""
    fakes.write_instance(tmp_path / "set[abc]" / "0")
    monkeypatch.chdir(tmp_path)
    assert main(["inspect", "set[abc]"]) == 0
    printed = capsys.readouterr().out
    assert "dataset set[abc]" in printed and "out/inspect/set[abc]/report.html" in printed


def test_a_name_that_is_no_text(tmp_path: Path) -> None:
    """Named case: the page was a traceback, after the work."""
    fakes.write_instance(tmp_path / "data" / "0")
    data = (tmp_path / "data").rename(tmp_path / os.fsdecode(b"d\xff"))
    assert main(["inspect", str(data), "--out", str(tmp_path / "out")]) == 0
    assert "d\\udcff" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_a_folder_that_cannot_be_made_is_noticed_before_the_work(tmp_path, capsys) -> None:
    fakes.write_instance(tmp_path / "data" / "0")
    (tmp_path / "file").touch()
    assert main(["inspect", str(tmp_path / "data"), "--out", str(tmp_path / "file")]) == 2
    found = capsys.readouterr()
    assert "is a file, not a folder" in found.err and not found.out
