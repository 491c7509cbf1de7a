"""What people read: the guide beside the page, offline; the manual pages, as the programs are; the
documents and where they lead."""

import html
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[2]
GUIDE = SOURCE / "web" / "guide" / "index.html"


class Links(HTMLParser):
    """Every place that a page loads from or leads to, and its own anchors."""

    def __init__(self):
        super().__init__()
        self.found, self.anchors = [], set()

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.found += [attrs[name] for name in ("href", "src") if name in attrs]
        self.anchors.add(attrs.get("id"))


def links(text):
    parser = Links()
    parser.feed(text)
    return parser


def help_of(program, *words):
    return subprocess.run([program, *words], check=True, capture_output=True, text=True).stdout


DOCUMENTS = [SOURCE / name for name in subprocess.run(
    ["git", "ls-files", "*.md"], cwd=SOURCE, capture_output=True, text=True).stdout.split()]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(SOURCE)))
def test_documents_lead_somewhere(document):
    text = document.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)#\s]+)\)", text):
        assert "://" in link or (document.parent / link).exists(), link
    for path in re.findall(r"`([\w.-][\w./-]*/[\w.-]+\.(?:c|h|cuh|py|md|sh|yaml|json))`", text):
        roots = (document.parent, SOURCE, SOURCE / "server", SOURCE / "server" / "engine")
        assert "NAME" in path or any((root / path).exists() for root in roots), path


def test_front_door_is_short():
    assert len((SOURCE / "README.md").read_text(encoding="utf-8").splitlines()) <= 200


def client_helps(build):
    """The help of each verb of the client, by name."""
    client = build / "client" / "ripnerf"
    names = re.findall(r"^  ([a-z]+) .*  \S", help_of(client, "help"), re.M)
    return {name: help_of(client, "help", name) for name in names if name != "help"}


def test_guide_is_served_whole(shared):
    """The guide and everything it loads come from the daemon alone."""
    reply = shared.get("/web/guide/index.html")
    assert reply.status == 200
    page = links(reply.body.decode())
    assert len(page.found) > 10
    for link in page.found:
        assert "//" not in link, f"{link} is not on this machine"
        if link.startswith("#"):
            assert link[1:] in page.anchors, link
            continue
        path = link if link.startswith("/") else f"/web/guide/{link}".replace("/guide/../", "/")
        assert shared.get(path).status == 200, link


def test_page_leads_to_the_guide():
    assert "web/guide/index.html" in links((SOURCE / "web" / "index.html").read_text()).found


def commands(text, program):
    """Lines of the guide's examples that call the program."""
    for block in re.findall(r"<pre>(.*?)</pre>", text, re.S):
        for line in html.unescape(block).splitlines():
            if line.split()[:1] == [program]:
                yield line.split()[1:]


def test_examples_of_the_guide_are_commands(build):
    helps = client_helps(build)
    seen = set()
    for words in commands(GUIDE.read_text(), "ripnerf"):
        assert words[0] in helps, words
        seen.add(words[0])
        for word in words:
            if word.startswith("-"):
                option = word.split("=")[0]
                assert re.search(rf"{option}\b", helps[words[0]]), f"{words[0]} knows no {option}"
    assert {"synth", "import", "train", "render", "path", "eval"} <= seen


def test_options_in_the_guide_exist(build):
    known = "\n".join(client_helps(build).values())
    known += help_of(build / "server" / "ripnerfd", "--help")
    for option in set(re.findall(r"--[a-z][a-z-]*", GUIDE.read_text())):
        assert re.search(rf"{option}\b", known), option


@pytest.fixture(scope="module", params=["ripnerf.1", "ripnerfd.8"])
def manual(request, build):
    page = build / "client" / request.param
    if not page.is_file():
        subprocess.run(["ninja", "-C", build, f"client/{request.param}"], check=True)
    return page


def test_manual_has_every_option(manual, build):
    """The page was written by this build's program: each verb and option stands in it."""
    text = manual.read_text().replace("\\-", "-").replace("\\e", "\\")
    if manual.suffix == ".1":
        helps = client_helps(build)
        for name in helps:
            assert f"\n.SS {name}\n" in text
    else:
        helps = {"": help_of(build / "server" / "ripnerfd", "--help")}
    for said in helps.values():
        for option in re.findall(r"^  (-\S.*?)(?:  |$)", said, re.M):
            assert f"\n.B {option}\n" in text, option


def test_manual_is_roff(manual):
    groff = shutil.which("groff")
    if not groff:
        pytest.skip("groff is not installed")
    said = subprocess.run([groff, "-man", "-Tascii", "-P-cbou", "-ww", manual],
                          capture_output=True, text=True)
    assert said.returncode == 0 and not said.stderr, said.stderr
    assert "NAME" in said.stdout


def test_all_of_it_is_installed(build):
    plan = help_of("meson", "introspect", "--installed", build)
    for end in ("man1/ripnerf.1", "man8/ripnerfd.8", "ripnerf/web"):
        assert end in plan, end
