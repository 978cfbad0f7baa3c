"""Copies the pages of the documentation to build/docs, as the site has them: `make site`.

README is the first page. What lies outside of docs/ and is linked from there (the changelog, the cards of the networks)
becomes a page; a link to a source file becomes its path.
"""

import re
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "build" / "docs"
LINK = re.compile(r"\[([^\]]*)\]\(([^)#:\s]+)(#[^)]*)?\)")
OUTSIDE = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
"""File of the repository -> its page."""
WEIGHTS = Path("priors/weights")


def page_of(path: Path) -> Path | None:
    """Return the page that shows a file of the repository, relative to the site's root; None: none does."""
    if str(path) in OUTSIDE:
        return Path(OUTSIDE[str(path)])
    if path.parts[0] == "docs":
        return path.relative_to("docs")
    return Path("weights.md") if path.parent == WEIGHTS and path.suffix == ".md" else None


def with_links(text: str, source: Path, page: Path) -> str:
    """Return a page's text with links as the site has them.

    Args:
        text: Markdown.
        source: where it lies in the repository.
        page: where it comes to lie in the site.
    """

    def link(found: re.Match[str]) -> str:
        words, target, anchor = found.groups()
        there = (ROOT / source.parent / target).resolve().relative_to(ROOT)
        shown = page_of(there)
        if shown is None:
            return f"{words} (`{there}`)" if words != f"`{there}`" else words
        if shown == Path("weights.md"):
            anchor = f"#{there.stem}safetensors" if there.stem != "LICENSE" else "#licence-of-the-weights"
            anchor = anchor.replace("skysafetensors", "skynpz")
        up = [".."] * (len(page.parts) - 1)
        return f"[{words}]({'/'.join([*up, str(shown)])}{anchor or ''})"

    return LINK.sub(link, text)


def write(source: Path, page: Path) -> None:
    """Copy a Markdown file of the repository to its page."""
    target = OUT / page
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(with_links((ROOT / source).read_text(encoding="utf-8"), source, page), encoding="utf-8")


def write_cards() -> None:
    """Write the page of the networks' cards, one after the other, and their licence."""
    cards = sorted(path.relative_to(ROOT) for path in (ROOT / WEIGHTS).glob("*.md"))
    texts = [with_links((ROOT / card).read_text(encoding="utf-8"), card, Path("weights.md")) for card in cards]
    lower = [re.sub(r"^#", "##", text, flags=re.MULTILINE) for text in texts]
    (OUT / "weights.md").write_text("\n\n".join(["# Cards of the networks", *lower]), encoding="utf-8")


def main() -> None:
    """Copy everything anew."""
    shutil.rmtree(OUT, ignore_errors=True)
    for path in sorted((ROOT / "docs").rglob("*")):
        page = path.relative_to(ROOT / "docs")
        if path.suffix == ".md":
            write(path.relative_to(ROOT), page)
        elif path.is_file() and path.suffix != ".py":
            (OUT / page).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, OUT / page)
    for source, name in OUTSIDE.items():
        write(Path(source), Path(name))
    write_cards()


if __name__ == "__main__":
    main()
