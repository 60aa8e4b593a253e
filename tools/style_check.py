"""Check what users read against the rules of docs/style.md that a program can check.

    python tools/style_check.py            exit 1 and a line for each breach

It reads the strings of messages, labels and tooltips by the syntax tree, and README.md, CHANGELOG.md and docs/*.md
outside code.  docs/decisions are history and are not read.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
HISTORY = ("docs/decisions/",)
USERS = {  # pages that users work with
    "README.md", *(f"docs/{name}.md" for name in (
        "compare", "estimate", "export", "farms", "guide", "index", "install", "large", "lights", "limitations",
        "material", "parameters", "reference", "report", "shooting", "shoots", "troubleshooting"))}
RULES = "docs/style.md"  # quotes what it forbids
LONGEST = 200  # letters of a tooltip

# Of messages, tooltips and pages: what must not stand in them, and what to write.
CONSTRUCTIONS = (
    (r"[;:,(] want (?!to\b)", "must be, or an imperative"),
    (r"(?<!here )\bis no (?!longer\b|more\b|less\b|need\b|further\b|such\b|GPU\b|worse\b|better\b)", "is not a"),
    (r"\bso (?:is|are|does|do) the\b", "name the subject, then the verb"),
    (r"\b(?:speaks?|tells?|told) of\b", "names, shows"),
    (r"\belse (?:they|it|he) (?:is|are)\b", "otherwise"),
    (r"\bof its own accord\b", "by itself"),
    (r"\banew\b", "again"),
    (r"\bbeyond doubt\b", "clearly, certain"),
    (r"\b(?:not|nothing|none)\b[^.;:]* says? (?:so|nothing)\b", "state it"),
    (r"\bsays nothing of\b", "does not show"),
    (r"\bwhence\b|\bthereof\b|\bwherein\b|\bof old\b|\bas of yet\b", "plain words"),
    (r"\bper cent\b|\bpercent\b", "%"),
    (r"\b(?:a|one) (?:channel|side|texel|picture|lamp|material|pixel) a (?:channel|side|texel)\b", "per"),
    (r"\b(?:pixels|bits|numbers|observations) a (?:side|texel|channel|pixel|sample)\b", "per"),
    (r"(?<=[a-z,.;:])  (?=\S)", "one space"),
)
PERCENT = (r"(?<![\w&{.])\d[\d.,]*%(?!\d|[sdif]\b)", "17 %, with a space")
# Only of messages and of pages that users work with.
ACTOR = (
    (r"\b(?:tells?|told)\b", "shows, names"),
    (r"\bsays\b", "states"),
)
SMALL = {"a", "an", "and", "as", "at", "by", "for", "from", "in", "into", "of", "on", "or", "so", "the", "to", "with",
         "per", "px", "vs."}
LABELS = {"bl_label"}
TOOLTIPS = {"bl_description", "description", "doc"}
ERRORS = {"BadInput", "DeviceError", "NoDevice", "OutOfDeviceMemory", "DeviceLost", "ShaderRefused", "UnusablePatch",
          "Finding", "Remedy", "poll_message_set", "report", "ArgumentTypeError"}


def main() -> int:
    """Print every breach."""
    lines = [*code(), *pages()]
    print("\n".join(lines), file=sys.stderr)
    return 1 if lines else 0


# ---- code


def code() -> Iterator[str]:
    """Breaches in the strings of the add-on."""
    for folder in ("irpso_addon", "operators"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            yield from of_code(path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix())


def of_code(source: str, name: str) -> Iterator[str]:
    """Breaches in one file."""
    tree = ast.parse(source)
    passed_over = {id(node) for node in _docstrings(tree)} | _inside(tree)
    for node in ast.walk(tree):
        yield from _of_names(node, name)
        if id(node) in passed_over:
            continue
        text = _text(node)
        if text is not None and re.search(r"[a-z]{2,} \S", text):  # a phrase
            yield from _breaches(f"{name}:{node.lineno}", text, (*CONSTRUCTIONS, PERCENT, *ACTOR))
            if any(spec.endswith("%") for spec in _formats(node)):
                yield f"{name}:{node.lineno}: '{' '.join(text[:35].split())}': write 17 %, with a space (percent)"


def _of_names(node: ast.AST, name: str) -> Iterator[str]:
    """Labels and tooltips: keywords of properties and rows of the parameter table, and classes' bl_label."""
    if isinstance(node, ast.keyword) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
        if node.arg == "label" or (node.arg == "name" and _is_label(node.value.value)):
            yield from label(f"{name}:{node.value.lineno}", node.value.value)
        elif node.arg in TOOLTIPS:
            yield from tooltip(f"{name}:{node.value.lineno}", node.value.value)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "parameter":
        words = [arg.value for arg in node.args if isinstance(arg, ast.Constant) and isinstance(arg.value, str)]
        yield from tooltip(f"{name}:{node.lineno}", words[-1])
    elif isinstance(node, ast.ClassDef):
        yield from _of_class(node, name)


def _of_class(node: ast.ClassDef, name: str) -> Iterator[str]:
    for line in node.body:
        targets = [target.id for target in getattr(line, "targets", []) if isinstance(target, ast.Name)]
        value = getattr(line, "value", None)
        if not isinstance(value, ast.Constant) or not isinstance(value.value, str):
            continue
        if LABELS & {*targets} and value.value:
            yield from label(f"{name}:{value.lineno}", value.value)
        elif TOOLTIPS & {*targets}:
            yield from tooltip(f"{name}:{value.lineno}", value.value)
    if "_OT_" in node.name and not any("bl_description" in ast.dump(line) for line in node.body):
        yield from tooltip(f"{name}:{node.lineno}", " ".join((ast.get_docstring(node) or "").split()))


def label(where: str, text: str) -> Iterator[str]:
    """Title Case, as Blender's labels; no full stop."""
    if "{" in text:
        return
    words = re.findall(r"[A-Za-z][\w'.-]*", re.sub(r"'[^' ]*'", "", text))
    wrong = [word for i, word in enumerate(words) if word[0].islower() and (i == 0 or word not in SMALL)]
    if wrong and not any("_" in word for word in wrong):
        yield f"{where}: label '{text}': write {wrong[0]} with a capital"
    if text.endswith("."):
        yield f"{where}: label '{text}': no full stop"


def tooltip(where: str, text: str) -> Iterator[str]:
    """A capital first, no full stop last, not too long."""
    if not text:
        yield f"{where}: no tooltip"
    elif text.endswith("."):
        yield f"{where}: tooltip '{text[:40]}...': no full stop at the end"
    elif len(text) > LONGEST:
        yield f"{where}: tooltip '{text[:40]}...': {len(text)} letters, at most {LONGEST}"
    elif text[0].islower() and not text.startswith(("captures.json",)):
        yield f"{where}: tooltip '{text[:40]}': begin with a capital"


def _is_label(text: str) -> bool:
    """Whether a keyword `name` is that of a property, not of a file, a node or a socket."""
    return text[:1].isupper() and "{" not in text


def _text(node: ast.AST) -> str | None:
    """The string of a node, in f-strings with {} for what is put in."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
    return None


def _formats(node: ast.AST) -> Iterator[str]:
    """How an f-string writes the numbers that are put in: ".1%"."""
    for part in getattr(node, "values", ()):
        if isinstance(part, ast.FormattedValue) and part.format_spec is not None:
            yield _text(part.format_spec) or ""


def _docstrings(tree: ast.AST) -> Iterator[ast.AST]:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(tree):
        if isinstance(node, kinds) and node.body and isinstance(node.body[0], ast.Expr):
            if not (isinstance(node, ast.ClassDef) and re.search(r"_(OT|PT|MT)_", node.name)):  # those are tooltips
                yield node.body[0].value


def _inside(tree: ast.AST) -> set[int]:
    """What is part of an f-string, which is read whole."""
    return {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)
            for part in ast.walk(node) if part is not node}


# ---- pages


def pages() -> Iterator[str]:
    """Breaches in the documentation."""
    for path in sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")]):
        name = path.relative_to(ROOT).as_posix()
        if name != RULES and not name.startswith(HISTORY):
            yield from of_page(path.read_text(encoding="utf-8"), name, ACTOR if name in USERS else ())


def of_page(text: str, name: str, more: tuple[tuple[str, str], ...] = ()) -> Iterator[str]:
    """Breaches in one page, outside code."""
    inside = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            inside = not inside
        elif not inside and not line.startswith("    "):
            prose = re.sub(r"`[^`]*`|\]\([^)]*\)|<!--.*?-->|\$[^$]*\$", "", line)
            yield from _breaches(f"{name}:{number}", prose, (*CONSTRUCTIONS[:-1], PERCENT, *more))


def _breaches(where: str, text: str, rules: tuple[tuple[str, str], ...]) -> Iterator[str]:
    for pattern, instead in rules:
        found = re.search(pattern, text)
        if found:
            start = max(found.start() - 20, 0)
            yield f"{where}: '{' '.join(text[start:found.end() + 15].split())}': write {instead}"


if __name__ == "__main__":
    sys.exit(main())
