# SPDX-License-Identifier: Apache-2.0
"""Pages of reports: every text in every language, structure for all readers, times, hashes, and PDF."""

import os
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from jinja2 import nodes
from jinja2.ext import extract_from_ast

from scara_effmass.analysis.identification import ScaleByMotion
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.protocol import Protocol, protocol_yaml
from scara_effmass.analysis.protocol_evaluation import evaluated
from scara_effmass.analysis.protocol_evaluation import write_report as write_protocol
from scara_effmass.analysis.report import (
    TEMPLATES,
    PageOptions,
    catalogue,
    css_string,
    environment,
    file_hashes,
    new_figure,
    phrases,
    print_pdf,
    report_figure,
    setting_rows,
    translated,
    write_report_files,
)
from scara_effmass.analysis.summary import iso_time
from scara_effmass.analysis.validation import Validation, ValidationSettings
from scara_effmass.analysis.validation_report import write_report
from scara_effmass.codes import Reason
from scara_effmass.errors import OutputError
from scara_effmass.iso15066 import EDITION
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety.reasons import LOAD_ENTRY, TEXTS
from scara_effmass.safety.remedies import remedy
from test.analysis.conftest import RAW, changed, content

REPORTS = ("report", "glossary", "macros", "validation", "run", "protocol")
LANGUAGES = ("de",)
SYMBOLS = {"ISO", "PAS", "RIA", "TR", "TS", "SHA", "UNKNOWN", "N", "R", "m", "s", "r", "ms"}
"""Words that are the same in every language."""
GERMAN = PageOptions("de")
CHROMIUM = shutil.which("chromium")


def source(name: str) -> str:
    return (TEMPLATES / f"{name}.html").read_text(encoding="utf-8")


def messages(name: str) -> set[str]:
    found = extract_from_ast(environment("en").parse(source(name)))
    return {message for _, _, message in found if isinstance(message, str)}


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("name", REPORTS)
def test_every_text_of_a_template_is_in_the_catalogue(name: str, language: str) -> None:
    assert messages(name) - catalogue(language).keys() == set()


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_translation_keeps_placeholders_and_numbers(language: str) -> None:
    texts = catalogue(language)
    assert len(texts) > 400
    for english, text in texts.items():
        assert sorted(re.findall(r"%\(\w+\)s|%%|…", english)) == sorted(re.findall(r"%\(\w+\)s|%%|…", text)), english
        assert text.strip() == text != ""
        assert not re.search(r"\d,\d", text), "all numbers of a report have a decimal point"


@pytest.mark.parametrize("name", REPORTS)
def test_a_template_holds_no_text_outside_of_the_catalogue(name: str) -> None:
    tree = environment("en").parse(re.sub(r"(?s){% block style %}.*?{% endblock %}", "", source(name)))
    text = "\f".join(node.data for node in tree.find_all(nodes.TemplateData))
    text = re.sub(r"(?s)<[^>]*?(>|$)|^[^<]*?>", "\f", text.replace("\f<", "<"))
    words = set(re.findall(r"[A-Za-z]+", re.sub(r'[\w-]+="[^"]*"?|"[^"]*"', "", text)))
    assert words - SYMBOLS == set()


def test_lines_of_a_run_are_translated() -> None:
    lines = (TEMPLATES.parent / "summary.py").read_text(encoding="utf-8")
    subjects = {subject.strip() for subject in re.findall(r'yield "([^"]+)", ', lines)}
    assert len(subjects) >= 7
    assert subjects <= catalogue("de").keys()


@pytest.mark.parametrize("language", LANGUAGES)
def test_reasons_and_remedies_of_verdicts_are_translated(language: str) -> None:
    """Except for details, which come from elsewhere, and what the protocol of a joint or robot says."""
    own = {"{detail}", "{masses}", "{assumed}", ""}
    texts = [re.sub(r"\{[^}]*\}", "7", text) for text in TEXTS.values() if text not in own]
    for text in (*texts, *map(remedy, Reason)):
        assert all(is_known for _, is_known in phrases(text, language)), text


@pytest.mark.parametrize("language", LANGUAGES)
def test_descriptions_of_settings_are_translated(language: str) -> None:
    """Those of every setting that a report can list, also of those at their defaults."""
    settings = ValidationSettings()
    for listed in (settings.validator, settings.detection, settings.monitor):
        for name, _, description in setting_rows(type(listed).__name__, listed):
            assert description, name
            assert all(is_known for _, is_known in phrases(description, language)), name


def test_values_of_settings_are_words_of_the_language() -> None:
    rows = {name.removeprefix("v: "): value for name, value, _ in setting_rows("v", ValidationSettings().validator)}
    assert (rows["obstacle_fixed"], rows["body_regions"], rows["obstacle_mass"]) == ("false", "", 0.0)
    assert translated("(empty)", "de") == "(leer)"


def test_reason_is_translated_with_its_words() -> None:
    text = "held after: 0.507 m/s is above the 0.503 m/s that the force limit of lower_leg allows"
    german = "gehalten nach: 0.507 m/s liegen über den 0.503 m/s, die der Grenzwert (Kraft) von Unterschenkel zulässt"
    assert "".join(part for part, _ in phrases(text, "de")) == german


def test_why_a_mass_decides_is_translated() -> None:
    text = "full: no lumped mass: joint4 moves the contact point along n, but no lumped mass (2.0%)"
    german = "full: keine Masse lumped: joint4 bewegt den Kontaktpunkt entlang n, aber keine konzentrierte Masse (2.0%)"
    assert "".join(part for part, _ in phrases(text, "de")) == german


@pytest.mark.parametrize(
    "text",
    [
        f"{LOAD_ENTRY}: 0.26 kg (0.23 to 0.28): up to 0.28 kg are not stated: state payload_mass and payload_com",
        f"{LOAD_ENTRY}: not observable by this motion (0.26 kg (0.23 to 0.28)): move joint3 to and fro",
        *(
            f"{LOAD_ENTRY}: unknown: {reason}: check torque_constants, masses and mounting of the robot file, payload"
            for reason in (
                "the effort of joint1 is +6974 % off the torque of the model",
                "the effort of joint1 is 0 while it moves",
                "the effort of joint1 is not the torque of the model",
                "the friction of joint1 pushes, as if its effort had the wrong sign",
                "the torques are those of a load of -2.00 kg",
            )
        ),
        f"{LOAD_ENTRY}: unknown: it needs joint states with finite effort of all joints, and about a second of motion",
        f"{LOAD_ENTRY}: unknown: it needs velocities as reported",
        f"{LOAD_ENTRY}: unknown: effort_uncertainty is 0",
        f"{LOAD_ENTRY}: unknown: it needs the full mass",
    ],
)
def test_load_by_the_torques_is_translated(text: str) -> None:
    assert all(is_known for _, is_known in phrases(text, "de"))


def test_text_before_a_second_bracket_is_translated_with_its_first() -> None:
    text = "the lumped mass matrix is singular (lumping.policy project_com and mass_at_com approximate) (100.0%)"
    german = "Die Massenmatrix lumped ist singulär (lumping.policy project_com und mass_at_com nähern an) (100.0%)"
    assert translated(text, "de") == german


def test_titles_and_long_lines_of_a_figure_are_translated() -> None:
    figure = new_figure(4.0, 2.0, "a robot: a bag, auto mass")
    text = figure.text(0.0, 0.5, f"mass: full: no lumped mass: link behind {'x' * 200}: none")
    report_figure("run", "", "", figure, "de")
    assert figure.get_suptitle() == "a robot: a bag, Masse auto"
    assert text.get_text() == "Masse: full: keine Masse lumped: Glied hinter [...]"


@pytest.mark.parametrize(
    ("contact", "german"),
    [
        ("contact 2", "Kontakt 2"),
        ("contact 2, run.csv", "Kontakt 2, run.csv"),
        ("contact 2, 300.0 N in run.csv", "Kontakt 2, 300.0 N in run.csv"),
        ("contact 2, by 11 degrees", "Kontakt 2, um 11 Grad"),
        ("contact 2, 3 s, 9 N after 0.5 s", "Kontakt 2, 3 s, 9 N nach 0.5 s"),
    ],
)
def test_contacts_that_a_reason_names_are_translated(contact: str, german: str) -> None:
    assert translated(contact, "de") == german


def test_numbers_of_a_text_from_the_code_are_kept() -> None:
    assert translated("stale (1 cycle)", "de") == "stale (1 Zyklus)"
    assert translated("1 cycle, 0.01 s (2.0%)", "de") == "1 Zyklus, 0.01 s (2.0%)"
    assert translated("too few contacts: 2 of 3", "de") == "zu wenige Kontakte: 2 von 3"
    assert translated("correlation 0.7814 is below 0.95", "en") == "correlation 0.7814 is below 0.95"
    assert translated("never heard of", "de") is None
    assert (translated(EDITION, "de") or "").startswith("ISO/TS 15066:2016, Anhang A (übernommen in ISO 10218-2:2025;")
    parts = list(phrases("raw data changed: run1; 2", "de"))
    assert parts == [("Rohdaten verändert", True), (": ", True), ("run1; 2", False)]


@given(st.text(min_size=1))
@example("run … 2")
@example("too few contacts: … of 3")
def test_no_text_from_the_code_is_lost_or_unescaped(text: str) -> None:
    assert "".join(part for part, _ in phrases(text, "en")) == text
    shown = environment("de").from_string("{{ text | t }}").render(text=text)
    assert shown.count("<") == 2 * shown.count('<span lang="en">')
    assert "<" not in css_string(text)
    assert "\n" not in css_string(text)


@given(st.integers(0, 4 * 10**18))
def test_times_are_dates_with_a_zone(stamp_ns: int) -> None:
    text = iso_time(stamp_ns)
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z", text)
    assert int(text[20:26]) == stamp_ns // 1000 % 1_000_000


class Reader(HTMLParser):
    """What a screen reader finds on a page, and the texts that are not marked as English."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.language = ""
        self.headings: list[int] = []
        self.problems: list[str] = []
        self.texts: list[str] = []
        self._open: list[tuple[str, bool]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag == "html":
            self.language = values.get("lang") or ""
        if re.fullmatch(r"h\d", tag):
            self.headings.append(int(tag[1]))
        needed = {"img": "alt", "svg": "aria-label", "th": "scope"}.get(tag)
        if needed and not values.get(needed):
            self.problems.append(f"{tag} without {needed}")
        if tag not in {"meta", "img", "br", "path", "polyline"}:
            outer = self._open[-1][1] if self._open else False
            self._open.append((tag, outer or tag == "style" or values.get("lang") == "en" != self.language))

    def handle_endtag(self, tag: str) -> None:
        if self._open and self._open[-1][0] == tag:
            self._open.pop()

    def handle_data(self, data: str) -> None:
        if data.strip() and not self._open[-1][1]:
            self.texts.append(data.strip())


@pytest.fixture(scope="session")
def protocol_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a protocol of measured contacts and its raw data."""
    folder = tmp_path_factory.mktemp("protocol")
    (folder / "raw.csv").write_bytes(RAW)
    values = changed(content(), {"tests": [{"motion": {"safety_setting": None}, "note": "<b>&"}]})
    (folder / "protocol.yaml").write_text(protocol_yaml(Protocol.model_validate(values)), encoding="utf-8")
    return folder


def protocol_page(folder: Path, output: Path, options: PageOptions) -> str:
    values = changed(content(), {"tests": [{"motion": {"safety_setting": None}, "note": "<b>&"}]})
    protocol = evaluated(Protocol.model_validate(values), folder)
    write_protocol(protocol, folder / "protocol.yaml", output, options, overwrite=False)
    return (output / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="session", params=["validation", "protocol"])
def pages(
    request: pytest.FixtureRequest,
    validation: Validation,
    dynamics: RobotDynamics,
    protocol_folder: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, str]:
    """A report in English and in German."""
    by_motion = validation._replace(by_motion={"lumped": ScaleByMotion(0.96, 0.041, 3)})
    made = {}
    for options in (PageOptions(), GERMAN):
        folder = tmp_path_factory.mktemp(options.language)
        if request.param == "protocol":
            made[options.language] = protocol_page(protocol_folder, folder, options)
        else:
            write_report(by_motion, ValidationSettings(), dynamics.robot, folder, options, overwrite=False)
            made[options.language] = (folder / "report.html").read_text(encoding="utf-8")
    return made


def test_a_german_page_shows_no_english(pages: dict[str, str]) -> None:
    english, german = Reader(pages["en"]), Reader(pages["de"])
    assert (english.language, german.language) == ("en", "de")
    texts = catalogue("de")
    same = {text for text in texts if texts[text] == text} | set(texts.values()) | {"none"}  # typed in
    assert {text for text in german.texts if text in texts} - same == set()
    assert len(set(english.texts) & texts.keys()) > 40  # what would have been found
    assert not [text for text in german.texts if re.search(r"\d to \d", text)]


def test_a_page_can_be_read_without_seeing_it(pages: dict[str, str]) -> None:
    for page in pages.values():
        reader = Reader(page)
        assert reader.problems == []
        assert reader.headings[0] == 1
        assert reader.headings.count(1) == 1
        assert all(after - before <= 1 for before, after in zip(reader.headings, reader.headings[1:], strict=False))


def test_the_verdict_is_on_the_first_screen(pages: dict[str, str]) -> None:
    for page in pages.values():
        assert page.index('class="verdict') < page.index("<table")
        assert len(re.sub(r"(?s)<style>.*?</style>|<[^>]*>", "", page[: page.index("<table")])) < 1200


def test_a_protocol_names_what_is_missing_and_the_hash_of_its_data(protocol_folder: Path, tmp_path: Path) -> None:
    page = protocol_page(protocol_folder, tmp_path, PageOptions())
    assert "missing: tests.1.motion.safety_setting" in page
    assert '<section class="verdict UNKNOWN"' in page
    assert file_hashes([protocol_folder / "raw.csv"])[0][1] in page
    assert "&lt;b&gt;&amp;" in page
    assert "SIMULATED" not in page


def luminance(colour: str) -> float:
    parts = (int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    linear = [part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_colours_of_texts_have_the_contrast_of_wcag_aa() -> None:
    style = (TEMPLATES / "style.css").read_text(encoding="utf-8")
    colours = dict(re.findall(r"--(\w+): (#\w{6})", style))
    backgrounds = ["#ffffff", colours["band"], *re.findall(r"section\.\w+ { background: (#\w{6})", style), "#e9e9e9"]
    assert len(backgrounds) == 6
    for name in ("ink", "soft", "ok", "warn", "bad", "unknown"):
        for background in backgrounds:
            light, dark = sorted((luminance(colours[name]), luminance(background)), reverse=True)
            assert (light + 0.05) / (dark + 0.05) >= 4.5, (name, background)


def browser(folder: Path, script: str) -> None:
    path = folder / "chromium"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)


@pytest.mark.parametrize("script", [None, "exit 1"])
def test_without_a_browser_nothing_is_written(
    script: str | None, protocol_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bin").mkdir()
    if script:
        browser(tmp_path / "bin", script)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    problem = "printed no page" if script else "needs Chromium or Chrome on the PATH"
    with pytest.raises(OutputError, match=f"--pdf: .*{problem}"):
        protocol_page(protocol_folder, tmp_path / "out", PageOptions(pdf=True))
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())
    if not script:
        with pytest.raises(OutputError, match="--pdf"):
            check_output_files(tmp_path / "out", PageOptions(pdf=True).files(), overwrite=False)


def test_pdf_is_what_the_browser_prints(protocol_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bin").mkdir()
    words = '--print-to-pdf=*) out="${word#*=}";; file://*) page="${word#file://}";;'
    browser(tmp_path / "bin", f'for word in "$@"; do case "$word" in {words} esac; done\ncp "$page" "$out"')
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    page = protocol_page(protocol_folder, tmp_path / "out", PageOptions(pdf=True))
    assert (tmp_path / "out" / "report.pdf").read_text(encoding="utf-8") == page
    write_report_files(tmp_path / "out", {"report.html": "another"}, overwrite=True)
    assert not (tmp_path / "out" / "report.pdf").exists()  # it was of the earlier page


@pytest.mark.live
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on the path: apt-get install chromium")
def test_pdf_has_a4_pages(protocol_folder: Path, tmp_path: Path) -> None:
    pdf = print_pdf(protocol_page(protocol_folder, tmp_path, PageOptions()))
    assert pdf.startswith(b"%PDF-")
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert len(boxes) >= 3
    assert {(round(float(width)), round(float(height))) for width, height in boxes} == {(595, 842)}
