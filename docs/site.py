# ruff: noqa: INP001 - a script for the documents, not of a package
"""The site's pages that do not lie in docs/: mkdocs calls this (``hooks`` in mkdocs.yml).

README, CONTRIBUTING and CHANGELOG are pages, too; the commands' options and what programs import
are made of the code itself. ``python docs/site.py`` prints both.
"""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer.core

import fuzzbee
from fuzzbee.app import build_command
from fuzzbee.attitudes import Attitudes
from fuzzbee.log_replay import LogReplay
from fuzzbee.replays.report import LogReport

ROOT = Path(__file__).resolve().parents[1]
# Pages of the repository's root, by their name on the site.
PAGES = {
    "index.md": "README.md",
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
}
COMMANDS_HEAD = """# Commands and options

The output of `--help`, for each command of the version that this site was built from.
"""
LONGEST_CALL = 70
# The marks behind an option's help: its default, a variable of the environment, whether it must be
MARKS = re.compile(r"\s*\[([^\]]*)\]$")
PROGRAMS_HEAD = """# What programs import

`from fuzzbee import ...`; examples are in [from Python](python.md).
"""


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that lie elsewhere or are generated."""
    from mkdocs.structure.files import File

    contents = {page: (ROOT / name).read_text("utf-8") for page, name in PAGES.items()}
    contents |= {"commands.md": commands_page(), "programs.md": programs_page()}
    for page, text in contents.items():
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links as they are between the site's pages."""
    return site_links(markdown)


def site_links(text: str) -> str:
    """Links between files of the repository as links between the site's pages."""
    text = re.sub(r"(\]\()docs/", r"\1", text)
    for page, name in PAGES.items():
        text = re.sub(rf"(\]\()(?:\.\./)?{re.escape(name)}", rf"\1{page}", text)
    return text


def commands_page() -> str:
    """Usage, options and examples of each command."""
    app = build_command(decorated=False)
    parts = [COMMANDS_HEAD]
    for path, command in _commands(app, ("fuzzbee",)):
        parts.append(f"## {' '.join(path)}\n\n{_prose(command.help)}\n")
        context = command.make_context(" ".join(path), [], resilient_parsing=True)
        parts += [_usage(path, command, context), _options(command, context)]
        if command.epilog:
            lines = [line.strip() for line in command.epilog.splitlines() if line.strip()]
            examples = "\n".join(line for line in lines if line.startswith("fuzzbee"))
            parts.append(f"```sh\n{examples}\n```\n")
    return "\n".join(parts)


def _commands(command: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """A command, or all that a group of them holds."""
    if not isinstance(command, typer.core.TyperGroup):
        yield path, command
        return
    for name, inner in command.commands.items():
        yield from _commands(inner, (*path, name))


def _usage(path: tuple[str, ...], command: Any, context: Any) -> str:
    words = " ".join(command.collect_usage_pieces(context))
    return f"```text\n{' '.join(path)} {words}\n```\n"


def _options(command: Any, context: Any) -> str:
    """A table of arguments and options, as the help has them."""
    lines = ["| option | default | what it does |", "| --- | --- | --- |"]
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None:
            names, text = (" ".join(part.split()) for part in record)
            found = MARKS.search(text)
            marks = found[1].split("; ") if found else []
            default = next((m[9:] for m in marks if m.startswith("default: ")), "")
            others = [f"({m})" for m in marks if not m.startswith("default: ")]
            text = " ".join([MARKS.sub("", text), *others]).replace("|", "\\|")
            lines.append(f"| `{names}` | {f'`{default}`' if default else ''} | {text} |")
    return "\n".join(lines) + "\n"


def _prose(text: str | None) -> str:
    """Help as it stands, without the parser's marks."""
    return inspect.cleandoc(text or "").replace("\b", "")


def programs_page() -> str:
    """The names of ``fuzzbee`` with their signatures, and what they give."""
    parts = [PROGRAMS_HEAD]
    for name in fuzzbee.__all__:
        value = getattr(fuzzbee, name)
        if inspect.isclass(value) and not issubclass(value, Exception):
            parts.append(_described(name, value))
            methods = inspect.getmembers(value, inspect.isfunction)
            parts += [_described(f"{name}.{k}", m) for k, m in methods if not k.startswith("_")]
        elif callable(value):
            parts.append(_described(name, value))
    parts += [_described(kind.__name__, kind) for kind in (Attitudes, LogReplay, LogReport)]
    return "\n".join(parts)


def _described(name: str, value: Any) -> str:
    """One name: its signature as code, its docstring as prose."""
    head = f"## {name}\n"
    doc = inspect.getdoc(value) or ""
    if not (inspect.isclass(value) and issubclass(value, Exception)):
        head += f"\n```python\n{_signature(name, value)}\n```\n"
    return f"{head}\n{_sections(doc)}\n"


def _signature(name: str, value: Any) -> str:
    """The call as its source has it, a parameter a line where they are many."""
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(value))).body
    gives = ""
    if isinstance(node, ast.ClassDef):
        made = [each for each in node.body if getattr(each, "name", "") == "__init__"]
        fields = [each for each in node.body if isinstance(each, ast.AnnAssign)]
        words = _parameters(made[0]) if made else [ast.unparse(each) for each in fields]
    else:
        words = _parameters(node)
        gives = f" -> {ast.unparse(node.returns)}"  # type: ignore[attr-defined]
    inner = ", ".join(words)
    if len(inner) > LONGEST_CALL:
        inner = "\n    " + ",\n    ".join(words) + ",\n"
    return f"{name}({inner}){gives}"


def _parameters(function: Any) -> list[str]:
    """The parameters with types and defaults, without self."""
    given = function.args
    given.args = [each for each in given.args if each.arg != "self"]
    words = re.split(r", (?=\w+:|\*)", ast.unparse(given))
    return [re.sub(r"(: [^=]+)=", r"\1 = ", word) for word in words]


def _sections(doc: str) -> str:
    """``Args:`` and ``Raises:`` as lists."""
    lines, found = doc.split("\n"), []
    for line in lines:
        if re.fullmatch(r"(Args|Raises|Returns):", line):
            found += [f"**{line[:-1]}**", ""]
        elif entry := re.fullmatch(r"    (\w+): (.*)", line):
            found.append(f"- `{entry[1]}`: {entry[2]}")
        else:
            found.append(line[2:] if line.startswith("    ") else line)
    return "\n".join(found).replace("``", "`")


if __name__ == "__main__":
    print(commands_page(), programs_page(), sep="\n")
