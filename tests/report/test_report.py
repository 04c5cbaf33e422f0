"""The report: nothing breaks out of its text, nothing comes from outside, and it reads without JavaScript."""

from __future__ import annotations

import base64
import hashlib
import itertools
import json
import math
import re
import shutil
import struct
import subprocess
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pages
from tasklift.errors import TaskliftError
from tasklift.report.charts import Mark, Row, Series, ticks
from tasklift.report.page import Link, Number, Report
from tasklift.text import number

VOID = {"meta", "img", "br", "link", "hr", "input"}
HOSTILE = "</script><script>alert(1)</script><img src=x onerror='alert(2)'>\"]]>--></title></svg>&amp;\x00"
HOSTILE_ADDRESS = "<a href='http://example.com/x'>"


def png() -> bytes:
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(b"\0\0")) + chunk(b"IEND", b"")


class Reader(HTMLParser):
    """Checks that tags nest, and keeps tags, attributes and texts."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.open, self.tags, self.texts, self.scripts, self.attributes = [], [], [], [], []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag == "script":
            self.scripts.append((dict(attrs).get("type"), ""))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            kind, text = self.scripts[-1]
            self.scripts[-1] = kind, text + data
        elif self.open and self.open[-1] != "style":
            self.texts.append(data)


def full(name: str) -> Report:
    y = np.linspace(500, 100, 20)
    report = Report(name)
    with report.fold(name):
        report.table([name], [[Link(name, "replays/a.html")]])
    return (
        report
        .headline(name, [Number(name, name, name)])
        .verdict(name)
        .warning(name)
        .footer(name)
        .section(name)
        .paragraph(name)
        .bullets([name])
        .code(name)
        .table([name, "effect", "verdict"], [[name, -1.5, "holds"], ["b", 2, "does not hold"]], caption=name)
        .figure(png(), name)
        .figure(b"<svg xmlns='http://www.w3.org/2000/svg' width='5' height='5'></svg>", name, alt=name)
        .curves([Series(name, y, y - 9, y + 9, each=y + 5), Series("one run", y)], title=name, y_label=name)
        .rows([Row(name, [Mark(-1.0, -2, 3, name, name), Mark(2, slug="b", name="b")], name)], title=name, label=name)
        .shares([(name, (0.5, 0.25, 0.25), name)], title=name, caption=name)
    )


@given(
    st.one_of(
        st.sampled_from([HOSTILE, HOSTILE_ADDRESS, "**`", "\u2028\ud800"]), st.text(min_size=1, max_size=30)
    )
)
@settings(deadline=None, derandomize=True, max_examples=60)
def test_no_text_can_break_the_page(name):
    page, tame = Reader(full(name).html()), Reader(full("name").html())
    marks = {"strong", "em", "code"}
    assert [t for t in page.tags if t not in marks] == [t for t in tame.tags if t not in marks]
    assert not [k for k, _ in page.attributes if k.startswith("on")]
    assert not re.search(r"[\x00-\x08\x0e-\x1f]", full(name).html())
    executed = [text for kind, text in page.scripts if kind is None]
    assert executed == [text for kind, text in tame.scripts if kind is None]
    data = [json.loads(text) for kind, text in page.scripts if kind == "application/json"]
    assert data[0]["series"][0]["name"] == name


def test_the_page_needs_no_network_and_allows_only_its_own_script():
    page = full("arm").html()
    reader = Reader(page)
    links = [value for key, value in reader.attributes if key in ("src", "href", "srcset", "action")]
    assert links
    assert all(value.startswith(("data:image/", "#s", "replays/")) for value in links)
    assert not re.findall(r"(?:https?:)?//[\w.]+\.\w+[^\s\"]*", re.sub(r"base64,[^\"]*", "", page))
    assert "@import" not in page
    assert "url(" not in page
    (script,) = [text for kind, text in reader.scripts if kind is None]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = next(value for key, value in reader.attributes if key == "content")
    assert policy.startswith("default-src 'none'")
    assert f"script-src 'sha256-{digest}'" in policy


def test_charts_are_drawn_without_javascript():
    reader = Reader(full("arm").html())
    assert {"path", "svg"} <= set(reader.tags)
    assert ("title", "arm: −1") in reader.attributes  # a dot's value
    drawn = [value for key, value in reader.attributes if key == "d"]
    assert len(drawn) == 4  # a band, a smoothed line, and each value; one line that is not smoothed
    for value in drawn:
        numbers = [float(n) for n in re.findall(r"-?\d+\.?\d*", value)]
        assert all(0 <= n <= 480 for n in numbers)


def places(page, kind):
    found = re.findall(rf'class="{kind} c\d" style="left: ([\d.]+)%(?:; width: ([\d.]+)%)?', page)
    return [tuple(float(part) for part in one if part) for one in found]


def test_a_dot_lies_where_its_value_is():
    rows = [Row("a", [Mark(0.0, slug="x"), Mark(2.5, 2.5, math.inf, slug="y")]), Row("b", [Mark(10, 5, 10, "x")])]
    page = Report("t").rows(rows).html()
    assert places(page, "dot") == [(0,), (25,), (100,)]
    assert places(page, "reach") == [(25, 75), (50, 50)]  # one without a bound goes to the end
    with pytest.raises(TaskliftError, match="rows"):
        Report("t").rows([Row("a", [])])


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
@settings(deadline=None, derandomize=True)
def test_names_at_the_ends_of_lines_do_not_cover_one_another(values):
    series = [Series(f"s{i}", [0.0, value]) for i, value in enumerate(values)]
    page = Report("t").curves(series, y_range=(0, 1)).html()
    tops = [float(top) for top in re.findall(r'style="top: ([\d.]+)%"', page)]
    assert len(tops) == len(values)
    assert all(b - a > 6.8 for a, b in itertools.pairwise(sorted(tops)))
    assert all(tops[i] < tops[j] for i, j in itertools.permutations(range(len(values)), 2)
               if values[i] > values[j] + 0.01)  # fmt: skip


def test_a_fold_is_closed_and_a_footer_is_the_end():
    page = Report("t").footer("made by hand")
    with page.fold("more"):
        page.paragraph("hidden")
    text = page.html()
    assert "<details><summary>more</summary>\n<p>hidden</p>\n</details>" in text
    assert "<main>" in text
    assert text.index("</main>") < text.index("<footer><p>made by hand</p></footer>")


def test_a_curve_keeps_its_colour_and_shows_gaps():
    y = np.array([1.0, 2.0, np.nan, 4.0])
    report = Report("t").curves([Series("a", y), Series("b", y)]).curves([Series("b", y)])
    page = report.html()
    first, second, again = re.findall(r'class="series (c\d)" data-series="\d"', page)
    assert first != second == again
    path = re.search(r'class="line"[^>]* d="([^"]*)"', page)
    assert path is not None
    assert path[1].count("M") == 2
    assert "nan" not in path[1]


def test_tables_say_numbers_and_verdicts():
    page = Report("t").table(["a", "b"], [[12345.6, "undecided"], [float("nan"), None]]).html()
    assert "12,346" in page
    assert '<span class="badge open short"><b>–</b> <span>undecided</span></span>' in page
    assert '<th scope="col" class=num>a</th>' in page
    few = Report("t").table(["a"], [["holds"], ["too few seeds (3 of at least 6)"]]).html()
    assert '<b>✓</b> <span>holds</span>' in few
    assert '<b>–</b> <span>too few seeds (3 of at least 6)</span>' in few


@given(st.floats(-1e12, 1e12), st.floats(1e-6, 1e12))
@settings(deadline=None, derandomize=True)
def test_ticks_cover_the_range_with_few_round_steps(low, span):
    marks = ticks(low, low + span)
    slack = 1e-6 * (abs(low) + span)
    assert marks[0] <= low + slack
    assert marks[-1] >= low + span - slack
    assert 2 <= len(marks) <= 13
    assert marks == sorted(marks)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (-1.5, "−1.5"),
        (1234567, "1,234,567"),
        (0.123456, "0.1235"),
        (math.inf, "∞"),
        (600, "600"),
    ],
)
def test_number(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    "call",
    [
        lambda r: r.table(["a"], [[1, 2]]),
        lambda r: r.figure(b"GIF89a"),
        lambda r: r.figure("no/such/file.png"),
        lambda r: r.curves([]),
        lambda r: r.curves([Series("a", [1, 2], [1], [2])]),
        lambda r: r.curves([Series("a", [1, 2])], x=[1, 2, 3]),
        lambda r: r.rows([Row("a", [Mark(math.nan)])]),
        lambda r: r.write("no/such/folder/report.html"),
    ],
)
def test_bad_input_is_named(call):
    with pytest.raises(TaskliftError):
        call(Report("t"))


@pytest.mark.slow
def test_a_browser_runs_it_without_an_error(tmp_path):
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no chromium here: the page is not opened in a browser")
    full(HOSTILE).write(tmp_path / "report.html")
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0"]
    done = subprocess.run(
        [*command, f"--user-data-dir={tmp_path}/profile", "--dump-dom", f"file://{tmp_path}/report.html"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert "CONSOLE" not in done.stderr
    assert 'aria-pressed="true"' in done.stdout  # the script has made the legend's buttons
    page = Reader(done.stdout)
    assert not [key for key, _ in page.attributes if key.startswith("on")]
    assert page.tags.count("img") == 2


@pytest.mark.skipif(pages.chromium() is None, reason="no chromium here: the page is not opened in a browser")
def test_a_wide_table_of_verdicts_does_not_widen_the_page(tmp_path):
    pytest.importorskip("playwright.sync_api")
    few = "too few seeds (3 of at least 6)"
    header = ["the paper says", *["copy+prior, scattered"] * 6]
    Report("t").table(header, [["indirect learning loses fewer robots", *[few] * 6]]).write(tmp_path / "report.html")
    with pages.browser() as started:
        assert set(pages.measure(started, tmp_path / "report.html").overflow.values()) == {0}
