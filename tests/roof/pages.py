"""A page read back with Python's own parser."""

from __future__ import annotations

from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path

VOID = {"meta", "link", "img", "br", "source"}


@dataclass
class Element:
    tag: str
    attributes: dict[str, str]
    children: list[Element | str] = field(default_factory=list)

    @property
    def text(self) -> str:
        return " ".join("".join(c if isinstance(c, str) else f"{c.text} " for c in self.children).split())

    def all(self, tag: str) -> list[Element]:
        found = []
        for child in self.children:
            if isinstance(child, Element):
                found += [child] * (child.tag == tag) + child.all(tag)
        return found

    def of_class(self, name: str) -> list[Element]:
        inner = [c for c in self.children if isinstance(c, Element)]
        hits = [c for c in inner if name in c.attributes.get("class", "").split()]
        return hits + [hit for c in inner for hit in c.of_class(name)]


class Reader(HTMLParser):
    """A tree of the page; fails on tags that do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.root = Element("root", {})
        self.open = [self.root]
        self.feed(text)
        self.close()
        assert self.open == [self.root], f"not closed: {self.open[-1].tag}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        element = Element(tag, {name: value or "" for name, value in attrs})
        self.open[-1].children.append(element)
        if tag not in VOID:
            self.open.append(element)

    def handle_endtag(self, tag: str) -> None:
        assert self.open[-1].tag == tag, f"</{tag}> closes <{self.open[-1].tag}>"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        self.open[-1].children.append(data)


def read(path: Path) -> Element:
    return Reader(path.read_text(encoding="utf-8")).root


def check_tables(page: Element) -> None:
    """Every table has a caption, and all of its rows have as many cells as its head."""
    for table in page.all("table"):
        assert table.all("caption")[0].text
        width = len(table.all("thead")[0].all("th"))
        assert {len(row.all("td") + row.all("th")) for row in table.all("tbody")[0].all("tr")} == {width}


def table_of(page: Element, name: str) -> list[list[str]]:
    """Cells of the table whose caption starts so, without the head."""
    [table] = [t for t in page.all("table") if t.all("caption")[0].text.startswith(name)]
    rows = table.all("tbody")[0].all("tr")
    return [[c.text for c in row.children if isinstance(c, Element)] for row in rows]
