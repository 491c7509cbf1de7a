#!/usr/bin/env python3
"""Writes a manual page out of what a program says of itself, so that the two cannot differ.

    manual.py PROGRAM FRAME > PAGE

FRAME is the page with what help texts do not say. A line `@OPTIONS@` becomes the options of --help, and
`@VERBS@` a subsection for each verb, out of `PROGRAM help VERB`; `@VERSION@` the version.
"""
import itertools
import re
import subprocess
import sys


def ask(program, *words):
    """What the program prints."""
    return subprocess.run([program, *words], check=True, capture_output=True, text=True).stdout


def plain(text):
    """Text as roff takes it: nothing in it is a request or an escape."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return "\n".join("\\&" + line if line[:1] in (".", "'") else line for line in text.splitlines())


def option(line):
    """The left and the right half of an option's line in a help text, or None."""
    match = re.match(r"  (-\S.*?)(?:  +(\S.*))?$", line)
    return match and (match[1], match[2] or "")


def options_of(text):
    """The lines of a program's options: from the first on, to the next blank line."""
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if option(line))
    return itertools.takewhile(str.strip, lines[first:])


def body(lines):
    """Paragraphs, and options as tagged paragraphs."""
    out, paragraph = [], []

    def close():
        if paragraph:
            out.extend([".PP", plain("\n".join(paragraph))])
            paragraph.clear()

    for line in lines:
        if option(line):
            close()
            name, meaning = option(line)
            out.extend([".TP", f".B {plain(name)}"] + [plain(meaning)] * bool(meaning))
        elif line.startswith("      ") and out and not paragraph:
            out.append(plain(line.strip()))
        elif line.strip():
            paragraph.append(line.strip())
        else:
            close()
    close()
    return "\n".join(out)


def sections(text):
    """The usage, and the lines before and under `options`."""
    usage, _, rest = text.partition("\n")
    said, _, options = rest.partition("\noptions\n")
    return usage.removeprefix("usage: "), said.splitlines(), options.splitlines()


def verbs(program):
    """A subsection a verb."""
    names = re.findall(r"^  ([a-z]+) .*  \S", ask(program, "help"), re.M)
    out = []
    for name in names:
        if name == "help":
            continue
        text = ask(program, "help", name).split("\noptions of every verb\n")[0]
        usage, said, options = sections(text)
        out += [f".SS {name}", f".B {plain(usage)}", body(said), body(options)]
    return "\n".join(part for part in out if part)


def main():
    program, frame = sys.argv[1:3]
    version = ask(program, "--version").split()[-1]
    with open(frame, encoding="utf-8") as lines:
        for line in lines.read().replace("@VERSION@", version).splitlines():
            if line == "@VERBS@":
                print(verbs(program))
            elif line == "@OPTIONS@":
                print(body(options_of(ask(program, "--help"))))
            else:
                print(line)


main()
