"""Print a shell completion script for commands, options and built-in names.

bash: add to ~/.bashrc:                 eval "$(trocar completion bash)"
zsh:  add to ~/.zshrc, after compinit:  eval "$(trocar completion zsh)"
fish: trocar completion fish > ~/.config/fish/completions/trocar.fish
"""

from __future__ import annotations

from argparse import Action, ArgumentParser, Namespace
from collections.abc import Iterator
from typing import TYPE_CHECKING

from trocar.cli.arguments import speed

if TYPE_CHECKING:
    from trocar.descriptions.catalogue import Shelf

SUMMARY = "print a shell completion script"
ORDER = 220

SHELLS = ("bash", "zsh", "fish")

BASH = """\
_trocar() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" words=""
  case "${{COMP_WORDS[1]}} ${{COMP_WORDS[COMP_CWORD-1]}}" in
{cases}
  esac
  [ "$COMP_CWORD" -eq 1 ] && words="{commands}"
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _trocar trocar
"""
ZSH = "autoload -Uz bashcompinit && bashcompinit\n"


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument("shell", choices=SHELLS, metavar="|".join(SHELLS), help="shell")


def run(args: Namespace) -> int:
    """Print the script."""
    print(_fish() if args.shell == "fish" else (ZSH if args.shell == "zsh" else "") + _bash())
    return 0


def _commands() -> Iterator[tuple[str, str, list[Action]]]:
    """Return (name, summary, arguments) of each command."""
    from trocar.cli.program import COMMANDS, build_parser

    for name, parser in build_parser().commands.items():
        yield name, COMMANDS[name], parser.arguments


def _values(action: Action) -> list[str]:
    """Return the known values of an argument; the shell completes file names."""
    from trocar.descriptions import names

    if action.choices is not None:
        return [str(choice) for choice in action.choices]
    if action.type is speed:
        return ["realtime", "max"]
    kinds: dict[str, tuple[Shelf, ...]] = {
        "--rig": ("rigs",),
        "ARM": ("arms",),
        "--arm": ("arms",),
        "ARM|RIG": ("arms", "rigs"),
    }
    key = action.option_strings[-1] if action.option_strings else str(action.metavar)
    return [name for kind in kinds.get(key, ()) for name in names(kind)]


def _bash() -> str:
    cases: list[str] = []
    listed: list[str] = []
    for name, _, actions in _commands():
        listed.append(name)
        words: list[str] = []
        for action in actions:
            words += action.option_strings or _values(action)
            if action.option_strings and action.nargs != 0:
                pattern = "|".join(f'"{name} {option}"' for option in action.option_strings)
                cases.append(f'    {pattern}) words="{" ".join(_values(action))}" ;;')
        cases.append(f'    "{name} "*) words="{" ".join(words)}" ;;')
    return BASH.format(cases="\n".join(cases), commands=" ".join(listed))


def _fish() -> str:
    lines: list[str] = []
    for name, summary, actions in _commands():
        lines.append(
            f"complete -c trocar -f -n __fish_use_subcommand -a {name} -d {_quoted(summary)}"
        )
        for action in actions:
            line = f"complete -c trocar -n '__fish_seen_subcommand_from {name}'"
            for option in action.option_strings:
                line += f" -l {option[2:]}" if option.startswith("--") else f" -s {option[1:]}"
            if values := _values(action):
                line += f" -a {_quoted(' '.join(values))}"
            if action.option_strings:
                line += (" -r" if action.nargs != 0 else "") + f" -d {_quoted(action.help or '')}"
            if values or action.option_strings:
                lines.append(line)
    return "\n".join(lines)


def _quoted(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"
