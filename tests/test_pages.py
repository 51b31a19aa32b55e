"""Pages tell the truth about what a machine can check: links lead somewhere, and files that are named exist."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from twohands.inference.decision import DecisionConfig

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
SHORT = {"docs/results.md": 150, "docs/experiments.md": 120}
"""Pages that must stay pages, and their most lines."""


def prose(page: Path) -> str:
    """Its text without blocks of code."""
    return re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def sentences(text: str) -> list[str]:
    """Of a page's prose: paragraphs and items of lists, without headings, tables and pictures."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith(("|", "#", "![", "<"))]
    blocks = re.split(r"\n\s*\n|\n\s*(?:[-*]|\d+\.) |^\s*(?:[-*]|\d+\.) ", "\n".join(lines), flags=re.MULTILINE)
    plain = (re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(block.split())) for block in blocks)
    return [part for block in plain for part in re.split(r"(?<=[.!?])(?<!e\.g\.)(?<!i\.e\.) ", block) if part]


def anchors(page: Path) -> set[str]:
    """Of its headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", prose(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if link.startswith(("http:", "https:")):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), f"{link} leads nowhere"
        if anchor:
            assert anchor in anchors(target), f"{link}: no such heading"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_hold_no_marks_of_a_merge(page: Path) -> None:
    """Named case: docs/video.md showed both sides of a conflict."""
    assert not re.search(r"^(<{7} |={7}$|>{7} )", page.read_text(encoding="utf-8"), flags=re.MULTILINE)


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent in (ROOT, ROOT / "docs")], ids=str)
def test_sentences_are_short_on_average(page: Path) -> None:
    """At most 25 words; tables, headings and code do not count."""
    lengths = [len(re.findall(r"\w[\w'.-]*", sentence)) for sentence in sentences(prose(page))]
    assert sum(lengths) <= 25 * len(lengths), f"{sum(lengths) / len(lengths):.1f} words a sentence"


def test_sentences_are_told_apart() -> None:
    text = "# Heading\n\nOne `a.b` of e.g. x.\nTwo: [a link](to.md). Three\n\n- four\n- five, or\n  so\n\n| a. | c |\n"
    assert sentences(text) == ["One `a.b` of e.g. x.", "Two: a link.", "Three", "four", "five, or so"]


@pytest.mark.parametrize("name", SHORT)
def test_pages_stay_short(name: str) -> None:
    assert len((ROOT / name).read_text(encoding="utf-8").splitlines()) <= SHORT[name]


def test_files_that_contributing_names_exist() -> None:
    table = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## House rules")[0]
    names = [name for name in re.findall(r"`([\w/]+\.(?:py|md|json))`", table) if not re.search("[A-Z]{4}", name)]
    assert len(names) > 25
    for name in names:
        found = [ROOT / name, ROOT / "src/twohands" / name, *ROOT.glob(f"src/twohands/weights/*/{name}")]
        assert any(path.exists() for path in found), name


def test_sources_name_pages_and_headings_that_exist() -> None:
    """A docstring that cites docs/PAGE.md, *Heading*, cites a heading of that page."""
    cited = re.compile(r"(docs/[\w/-]+\.md)(?:, \*([^*]+)\*)?")
    files = [path for room in ("src", "tests", "benchmarks", "scripts") for path in (ROOT / room).rglob("*.py")]
    for path in files:
        if path == Path(__file__).resolve():
            continue
        text = re.sub(r"\s*\n\s*", " ", path.read_text(encoding="utf-8"))
        for page, heading in cited.findall(text):
            assert (ROOT / page).exists(), f"{path}: {page}"
            if heading:
                headings = re.findall(r"^#+ (.*)$", (ROOT / page).read_text(encoding="utf-8"), flags=re.MULTILINE)
                assert any(known.startswith(heading) for known in headings), f"{path}: {page}, {heading}"


def test_names_that_contributing_gives_stand_in_the_files_of_their_row() -> None:
    """What a newcomer is told to look for is there."""
    table = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## House rules")[0]
    names = 0
    for row in re.findall(r"^\| .*", table, flags=re.MULTILINE):
        files = [ROOT / "src/twohands" / name for name in re.findall(r"`([\w/]+\.py)`", row)]
        texts = [file.read_text(encoding="utf-8") for file in files if file.exists()]
        for name in re.findall(r"`([A-Z]\w+|\w+_\w+)(?:\.\w+)?`", row) if texts else ():
            assert any(re.search(rf"\b{name}\b", text) for text in texts), f"{name}: {row[:40]}"
            names += 1
    assert names > 12


def test_every_number_that_decides_is_on_its_page_with_a_script() -> None:
    """Six at most, the values as in the code; the threshold of networks without a fitted decision is the seventh."""
    page = (ROOT / "docs/decision.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([\d.]+) \| [^|]+ \| `(scripts/\w+\.py)` \|", page, flags=re.MULTILINE)
    defaults = DecisionConfig()
    numbers = {field.name for field in fields(defaults) if isinstance(getattr(defaults, field.name), float)}
    assert len(rows) <= 6 and {name for name, _, _ in rows} == numbers - {"presence_threshold"}
    for name, value, script in rows:
        assert getattr(defaults, name) == float(value) and (ROOT / script).exists(), name
