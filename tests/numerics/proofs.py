"""Holds the Gappa proofs to the code that they are about: proofs.py SOURCE_ROOT.

Each proof quotes its code in lines that begin with `#>`, the file first. The quotation must stand in
that file as it is, and every number of it in the proof: a formula that changes needs its proof anew.
"""

import re
import struct
import sys
from pathlib import Path

NUMBER = re.compile(r"(?<![\w.])(?:\d+\.\d*|\d*\.\d+|\d+)(?:e[-+]?\d+)?(?![\w.]*[\w])")
# Numbers of the code that no rounding depends on: which bits the exponent is, where it is split,
# the nearest integer to x / ln 2, a guard against t = 0, halves (exact).
FREE = {"1.44269504088896341", "127", "23", "1", "1e-30", "0", "0.5"}


def single(text):
    return struct.unpack("f", struct.pack("f", float(text)))[0]


def numbers_of_proof(text):
    found = set()
    for left, right in re.findall(r"(\d+) / (\d+)", text):
        found.add(single(float(left) / float(right)))
    for mantissa, exponent in re.findall(r"(\d+)b(-?\d+)", text):
        found.add(single(int(mantissa) * 2.0 ** int(exponent)))
    return found | {single(number) for number in NUMBER.findall(text)}


def numbers_of_code(lines):
    code = "\n".join(line.split("//")[0] for line in lines)
    code = re.sub(r"0x\w+", "", code)
    code = re.sub(r"\(NUMBER\)(\d+) / (\d+)", lambda m: str(int(m[1]) / int(m[2])), code)
    code = re.sub(r"(?<=[\d.])f\b", "", code)
    return [number for number in NUMBER.findall(code) if number not in FREE]


def complaints(proof, root):
    text = proof.read_text(encoding="utf-8")
    quoted = [line[3:] for line in text.splitlines() if line.startswith("#> ")]
    body = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    if len(quoted) < 2:
        yield f"{proof.name}: quotes no code"
        return
    code = (root / quoted[0]).read_text(encoding="utf-8")
    code = re.sub(r" *\\$", "", code, flags=re.MULTILINE)  # of a macro's lines
    if "\n".join(quoted[1:]) not in code:
        yield f"{proof.name}: {quoted[0]} no longer has the code that is proved"
    known = numbers_of_proof(body)
    for number in numbers_of_code(quoted[1:]):
        if single(number) not in known:
            yield f"{proof.name}: {number} is not in the proof"


def main(root):
    root = Path(root)
    proofs = sorted((root / "tests/numerics/proofs").glob("*.gappa"))
    findings = [line for proof in proofs for line in complaints(proof, root)]
    print("\n".join(findings) or f"{len(proofs)} proofs are of the code as it is")
    return 1 if findings or not proofs else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
