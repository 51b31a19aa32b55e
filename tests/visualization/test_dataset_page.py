"""Charts state the shares they are given; the page holds them all and needs nothing else."""

import re
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser

import numpy as np
import pytest
from tests.datasets import fakes

from twohands.datasets.ego3dhands import Ego3DHands
from twohands.datasets.inspection.inspect import inspect_dataset
from twohands.formats import ego3dhands as fmt
from twohands.visualization.dataset_page import dataset_page
from twohands.visualization.svg import WIDTH, bin_shares, heat_map, histogram, nice_ceiling, nice_ticks, ranges


def test_shares_add_up_and_nothing_is_lost_beyond_the_ends():
    shares = bin_shares(np.array([-5.0, 0.5, 1.5, 1.6, 99.0, np.nan]), np.array([0.0, 1.0, 2.0, 3.0]))
    np.testing.assert_allclose(shares, [2 / 5, 2 / 5, 1 / 5])
    np.testing.assert_array_equal(bin_shares(np.array([np.nan]), np.arange(3.0)), [0, 0])


def test_bars_are_as_high_as_their_shares():
    root = ElementTree.fromstring(histogram([np.array([0.5, 0.5, 0.5, 1.5])], np.array([0.0, 1.0, 2.0]), "m"))
    heights = [float(rect.attrib["height"]) for rect in root.iter("rect")]
    assert heights[0] / heights[1] == pytest.approx(3, rel=0.01)
    assert [rect[0].text for rect in root.iter("rect")] == ["75.0 %", "25.0 %"]


def test_charts_stay_inside_their_frame():
    rng = np.random.default_rng(0)
    samples = [rng.normal(0, 50, (40, 5)), np.empty((0, 5))]
    charts = [
        histogram(samples, np.linspace(-90, 90, 37), "a < b & c"),
        ranges(samples, ["one", "two", "three", "four", "five"], 0, 100, "degrees"),
        heat_map(rng.integers(0, 9, (27, 48)), "joints"),
    ]
    for chart in charts:
        root = ElementTree.fromstring(chart)  # well-formed, with its labels escaped
        width, height = map(float, root.attrib["viewBox"].split()[2:])
        assert width == WIDTH
        for node in root.iter():
            for name, limit in (("x", width), ("x1", width), ("x2", width), ("y", height), ("y1", height)):
                assert -0.1 <= float(node.attrib.get(name, 0)) <= limit + 0.3


def test_ticks_are_round_numbers():
    assert nice_ticks(0, 100) == [0, 20, 40, 60, 80, 100]
    assert nice_ticks(-50, 50) == [-40, -20, 0, 20, 40]
    assert [nice_ceiling(v) for v in (0.11, 0.2, 0.21, 3, 10)] == [0.2, 0.2, 0.25, 5, 10]
    assert "-0" not in {f"{tick:g}" for tick in nice_ticks(-60, 60)}


class _Balanced(HTMLParser):
    """Fails where tags are not closed in order."""

    VOID = frozenset({"meta", "img", "br"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag, attrs) -> None:
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs) -> None:
        pass

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag


def test_page_of_two_datasets(tmp_path):
    for name in ("one", "two & three"):
        fakes.write_instance(tmp_path / name / "0")
        fakes.write_instance(tmp_path / name / "1", left=False)
    (tmp_path / "one" / "1" / fmt.DEPTH_FILE).write_bytes(b"")
    reports = [inspect_dataset(Ego3DHands(tmp_path / name)) for name in ("one", "two & three")]
    page = dataset_page(reports, [np.zeros((20, 30, 3), np.uint8), None])
    parser = _Balanced()
    parser.feed(page)
    assert parser.open == []
    assert "two &amp; three" in page and "two & three" not in page
    assert "depth.png: zero bytes" in page
    assert page.count("<svg") == 9 + 1 + 2 and page.count("data:image/jpeg") == 1
    assert not re.search(r"""(src|href)=["']?(https?:)?//|@import|url\(""", page)
    for word in ("Range", "Palm", "flexion", "overlap", "Visible", "Skin", "Hand length", "heat map"):
        assert word in page


def test_page_of_a_dataset_without_3d_labels_and_masks(tmp_path):
    fakes.write_instance(tmp_path / "0")
    for name in (fmt.JOINTS_3D_FILE, fmt.CANONICAL_FILE, fmt.LABELS_FILE, fmt.DEPTH_FILE):
        (tmp_path / "0" / name).unlink()
    page = dataset_page([inspect_dataset(Ego3DHands(tmp_path))], [None])
    assert "not labelled" in page and ">nan" not in page
