"""Renders a report as an A4 PDF file with the same parts and drawings as the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image

from gss.domain.words import counted
from gss.operations.report.draw import WIDTH, draw, height_of
from gss.operations.report.parts import Drawing, Fact, Note, Picture, Report, Section, Table
from gss.operations.report.pens import INK, SOFT, Point
from gss.operations.report.table_layout import TableLayout, table_layout

if TYPE_CHECKING:
    from fpdf import FPDF

FONTS = Path(__file__).parent.parent.parent / "web" / "fonts"
FACES = {"latin": "ibm-plex-sans-latin", "greek": "ibm-plex-sans-greek"}
"""Font of the console, which is part of the built pages. Its glyphs are split over two files."""
PLAIN = str.maketrans({"≤": "<=", "≥": ">=", "→": "to", "√": "root ", "⁻": "-", "₁": "1", "₂": "2", "₃": "3"})
BARE = str.maketrans({"σ": "sigma", "χ": "chi", "µ": "u", "″": '"', "′": "'", "−": "-", "×": "x", "Δ": "d", "ρ": "r"})
"""Replacements of characters for an installation without built pages. There, only the glyphs of the standard PDF fonts
are available."""
MARGIN, LINE, LEADING = 42.0, 12.0, 1.3
FACT_SIZE, FACT_GAP = 9.0, 14.0
LATIN_1 = 0x100
MAX_NAMED = 8
"""Maximum number of characters without a glyph that the note lists."""
MAX_ROWS = 400
"""Maximum number of rows of a table. The report states the number of omitted rows; the CSV file contains all rows."""


def as_pdf(report: Report, created: datetime) -> bytes:
    """Return the PDF file. ``created``: creation date of the file. The same report with the same date gives the same
    bytes."""
    sheet = _Sheet(report.title)
    sheet.pdf.set_creation_date(created)
    sheet.words(report.title, size=15, bold=True, gap=3)
    sheet.words(report.subtitle, colour=SOFT, gap=6)
    for note in report.notes:
        sheet.note(note)
    for section in report.sections:
        sheet.section(section)
    if sheet.replaced:
        letters = ", ".join(f"U+{ord(letter):04X}" for letter in sorted(sheet.replaced)[:MAX_NAMED])
        text = f'The fonts of this file do not contain {counted(len(sheet.replaced), "character")} ({letters}), shown as "?".'
        sheet.note(Note(text, "The HTML report contains them."))
    return bytes(sheet.pdf.output())


class _Sheet:
    """The PDF under construction and the position of the next part."""

    def __init__(self, title: str) -> None:
        from fpdf import FPDF  # imported here because the import takes 0.5 s

        self.pdf = FPDF(unit="pt", format="A4")
        self.pdf.set_auto_page_break(False)
        self.pdf.set_title(title)
        self.pdf.set_creator("GSS")
        self._faces = _faces(self.pdf)
        self._glyphs = {name: _glyphs(self.pdf, name) for name in FACES} if self._faces else {}
        self.replaced: set[str] = set()
        """Characters without a glyph, which are shown as "?"."""
        self.y = 0.0
        self._page()

    def _page(self) -> None:
        self.pdf.add_page()
        self.y = MARGIN

    def room(self, height: float) -> None:
        """Start a new page if the remaining height is too small."""
        if self.y + height > self.pdf.h - MARGIN:
            self._page()

    def words(self, text: str, *, size: float = 9, bold: bool = False, colour: str = INK, gap: float = 2) -> None:
        """Add a paragraph, wrapped at words."""
        for line in _lines(text, size, self.pdf.w - 2 * MARGIN):
            self.room(size * 1.35)
            self.y += size * 1.25
            self.put(MARGIN, self.y, line, size=size, colour=colour, bold=bold)
        self.y += gap

    def note(self, note: Note) -> None:
        """Add a warning with its hint."""
        label = "Do not rely on this: " if note.severe else "Note: "
        stop = "" if not note.hint or note.text.endswith((".", "!", "?")) else "."
        self.words(f"{label}{note.text}{stop} {note.hint}", colour="#a04600", gap=4)

    def section(self, section: Section) -> None:
        """Add a heading with its content. A page break never separates the heading from the first drawing or lines."""
        drawing_height = 0.0 if section.facts or not section.drawings else self._drawn_height(section.drawings[0])
        self.room(60 + drawing_height)
        self.y += 8
        self.words(section.title, size=11, bold=True, gap=1)
        self.pdf.set_draw_color("#999999")
        self.pdf.set_line_width(0.5)
        self.pdf.line(MARGIN, self.y + 1, self.pdf.w - MARGIN, self.y + 1)
        self.y += 4
        if section.text:
            self.words(section.text)
        self.facts(section.facts)
        self.y += 4
        for drawing in section.drawings:
            self.drawing(drawing)
        for table in section.tables:
            self.table(table)

    def facts(self, facts: Sequence[Fact]) -> None:
        """Add values in a column beside their labels, each with its note. A note that does not fit moves to the next line."""
        column = MARGIN + max((self._width(f.label, FACT_SIZE) for f in facts), default=0.0) + FACT_GAP
        for fact in facts:
            value = f"{fact.value} {fact.unit}".strip()
            beside = column + self._width(value, FACT_SIZE) + FACT_GAP
            fits = beside + self._width(fact.note, FACT_SIZE) <= self.pdf.w - MARGIN
            self.room(LINE if fits else 2 * LINE)
            self.y += LINE
            self.put(MARGIN, self.y, fact.label, colour=SOFT)
            self.put(column, self.y, value)
            if fact.note and not fits:
                self.y += LINE
            if fact.note:
                self.put(beside if fits else column, self.y, fact.note, colour=SOFT)

    def _drawn_height(self, drawing: Drawing) -> float:
        return 0.0 if isinstance(drawing, Picture) else height_of(drawing)

    def drawing(self, drawing: Drawing) -> None:
        """Add a drawing across the page."""
        if isinstance(drawing, Picture):
            self.picture(drawing)
            return
        height = height_of(drawing)
        self.room(height)
        draw(_PdfPen(self, MARGIN, self.y), drawing)
        self.y += height + 4

    def picture(self, picture: Picture) -> None:
        """Add a picture across the page, with its caption above it."""
        image = Image.open(io.BytesIO(base64.b64decode(picture.png)))
        across = self.pdf.w - 2 * MARGIN
        height = across * image.height / image.width
        self.room(height + 2 * LINE)
        self.words(f"{picture.title}: {picture.note}" if picture.note else picture.title)
        self.pdf.image(image, x=MARGIN, y=self.y, w=across, h=height)
        self.y += height + 4

    def table(self, table: Table) -> None:
        """Add a table. Text in columns that are too narrow is wrapped. The heading is repeated on each page."""
        if table.title:
            self.room(4 * LINE)
            self.words(table.title, bold=True, gap=2)
        if not table.rows:
            self.words("None.", colour=SOFT)
            return
        layout = table_layout([table.columns, *table.rows[:MAX_ROWS]], self.pdf.w - 2 * MARGIN, self._width)
        for number, row in enumerate(layout.rows):
            if self.y + self._row_height(row, layout) > self.pdf.h - MARGIN:
                self._page()
                self._row(layout.rows[0], layout, SOFT)
            self._row(row, layout, INK if number else SOFT)
        if len(table.rows) > MAX_ROWS:
            self.words(f"and {len(table.rows) - MAX_ROWS} more rows", colour=SOFT)
        self.y += 6

    def _row_height(self, row: Sequence[Sequence[str]], layout: TableLayout) -> float:
        return layout.size * LEADING * max(1, *(len(cell) for cell in row))

    def _row(self, row: Sequence[Sequence[str]], layout: TableLayout, colour: str) -> None:
        at = MARGIN
        for width, cell in zip(layout.widths, row, strict=True):
            for k, line in enumerate(cell):
                self.put(at, self.y + (k + 1) * layout.size * LEADING, line, size=layout.size, colour=colour)
            at += width
        self.y += self._row_height(row, layout)

    def _width(self, text: str, size: float) -> float:
        """Return the width of a text in points."""
        width = 0.0
        for face, run in self._runs(text):
            self._use(face, size, False)
            width += self.pdf.get_string_width(run)
        return width

    def put(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = 9,
        colour: str = INK,
        anchor: str = "start",
        bold: bool = False,
    ) -> None:
        """Draw text on its baseline. Each run of letters uses the font that contains these letters."""
        runs = list(self._runs(text))
        widths = []
        for face, run in runs:
            self._use(face, size, bold)
            widths.append(self.pdf.get_string_width(run))
        at = x - {"start": 0.0, "middle": sum(widths) / 2, "end": sum(widths)}[anchor]
        self.pdf.set_text_color(colour)
        for (face, run), width in zip(runs, widths, strict=True):
            self._use(face, size, bold)
            self.pdf.text(at, y, run)
            at += width

    def _runs(self, text: str) -> Iterator[tuple[str, str]]:
        """Split a text into runs of letters of one font. Yield (font, letters) in order."""
        text = text.translate(PLAIN)
        if not self._faces:
            yield "helvetica", "".join(self._known(letter, ord(letter) < LATIN_1) for letter in text.translate(BARE))
            return
        for face, letters in groupby(text, key=_face_of):
            yield face, "".join(self._known(letter, ord(letter) in self._glyphs[face]) for letter in letters)

    def _known(self, letter: str, has_glyph: bool) -> str:
        if has_glyph and letter.isprintable():
            return letter
        self.replaced.add(letter)
        return "?"

    def _use(self, face: str, size: float, bold: bool) -> None:
        self.pdf.set_font(face, "B" if bold and face != "greek" else "", size)


def _faces(pdf: FPDF) -> bool:
    """Load the console's fonts. Return False if the pages were not built."""
    files = {name: FONTS / f"{stem}-400-normal.woff" for name, stem in FACES.items()}
    bold = FONTS / f"{FACES['latin']}-600-normal.woff"
    if not all(path.is_file() for path in (*files.values(), bold)):
        return False
    for name, path in files.items():
        pdf.add_font(name, "", path)
    pdf.add_font("latin", "B", bold)
    return True


def _glyphs(pdf: FPDF, face: str) -> set[int]:
    """Return the code points that a loaded font contains."""
    from fpdf.fonts import TTFFont

    font = pdf.fonts[face]
    return set(font.cmap) if isinstance(font, TTFFont) else set()


def _face_of(letter: str) -> str:
    return "greek" if "\u0370" <= letter <= "\u03ff" else "latin"


def _lines(text: str, size: float, across: float) -> list[str]:
    """Wrap the lines of a text at words, and longer words at the width, assuming that letters are half as wide as they are
    high."""
    max_letters = int(across / (size * 0.5))
    return [line for paragraph in text.splitlines() for line in _wrapped(paragraph, max_letters)]


def _wrapped(paragraph: str, max_letters: int) -> list[str]:
    lines, line = [], ""
    for word in paragraph.split():
        for part in (word[k : k + max_letters] for k in range(0, len(word), max_letters)):
            if line and len(line) + 1 + len(part) > max_letters:
                lines.append(line)
                line = part
            else:
                line = f"{line} {part}".strip()
    return [*lines, line] if line or not lines else lines


class _PdfPen:
    """Draws into the PDF with an offset."""

    def __init__(self, sheet: _Sheet, x: float, y: float) -> None:
        self._sheet, self._pdf = sheet, sheet.pdf
        self._x, self._y = x, y
        self._scale = (sheet.pdf.w - 2 * MARGIN) / WIDTH

    def _at(self, x: float, y: float) -> Point:
        return self._x + x * self._scale, self._y + y * self._scale

    def line(self, points: Sequence[Point], colour: str, width: float = 1.0, dash: float = 0.0) -> None:
        self._pdf.set_draw_color(colour)
        self._pdf.set_line_width(width)
        self._pdf.set_dash_pattern(dash, dash)
        self._pdf.polyline([self._at(x, y) for x, y in points])
        self._pdf.set_dash_pattern()

    def box(self, x: float, y: float, width: float, height: float, stroke: str = "", fill: str = "") -> None:
        left, top = self._at(x, y)
        if stroke:
            self._pdf.set_draw_color(stroke)
            self._pdf.set_line_width(0.5)
        if fill:
            self._pdf.set_fill_color(fill)
        style = ("D" if stroke else "") + ("F" if fill else "")
        self._pdf.rect(left, top, max(0.0, width) * self._scale, max(0.0, height) * self._scale, style=style)

    def dots(self, points: Sequence[Point], colour: str, radius: float) -> None:
        self._pdf.set_fill_color(colour)
        for x, y in points:
            left, top = self._at(x, y)
            self._pdf.rect(left - radius * 0.8, top - radius * 0.8, 1.6 * radius, 1.6 * radius, style="F")

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = 8,
        colour: str = INK,
        anchor: str = "start",
        up: bool = False,
    ) -> None:
        left, top = self._at(x, y)
        if up:
            with self._pdf.rotation(90, x=left, y=top):
                self._sheet.put(left, top, text, size=size, colour=colour, anchor=anchor)
        else:
            self._sheet.put(left, top, text, size=size, colour=colour, anchor=anchor)
