"""xacro: URDF with macros, expanded without running code.

Properties, arguments, macros with defaults and blocks, conditions, includes, and expressions of
numbers, texts, lists and tables. Other elements are errors that name what is supported.

Source: the documentation of xacro (wiki.ros.org/xacro, github.com/ros/xacro/wiki).
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from trocar.formats.xml_tree import XmlNode, package_places, read_xml
from trocar.inputs import is_file, read_input

#: Namespaces of xacro's elements. Source: the documentation, and files of 2010 to 2013.
NAMESPACE = re.compile(
    r"\{https?://(?:www\.)?(?:ros\.org/wiki|ros\.org|wiki\.ros\.org)/xacro[/#\w]*\}"
)
#: Largest number of elements, of nested expansions, and of bytes of a YAML file. Source: our own
#: choice; the dVRK's setup joints with all arms have 4,000 and 8.
MOST_ELEMENTS, MOST_DEPTH, MOST_YAML = 100_000, 40, 1_000_000
#: Largest exponent, and number of characters of a text, in an expression.
MOST_POWER, MOST_TEXT = 64.0, 10_000
#: An argument of a macro: its name, ":=" or "=", "^" for the outer value, and the default.
PARAMETER = re.compile(
    r"(\*{0,2}[\w.\-]+)(?:\s*:?=\s*(\^\|?)?('[^']*'|\"[^\"]*\"|[^\s'\"]*))?(?:\s+|$)"
)
#: $$( or $${ , ${expression}, $(command).
PIECE = re.compile(
    r"\$\$(?=[{(])|\$\{((?:[^{}']|'[^']*'|\{[^{}]*\})*)\}"
    r"|\$\(([^()]*(?:\([^()]*\)[^()]*)*)\)"
)
SUPPORTED = ("property", "arg", "macro", "if", "unless", "include", "insert_block")

ANY: Any = operator
OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: ANY.add, ast.Sub: ANY.sub, ast.Div: ANY.truediv, ast.FloorDiv: ANY.floordiv,
    ast.Mod: ANY.mod, ast.USub: ANY.neg, ast.UAdd: ANY.pos, ast.Not: ANY.not_, ast.Eq: ANY.eq,
    ast.NotEq: ANY.ne, ast.Lt: ANY.lt, ast.LtE: ANY.le, ast.Gt: ANY.gt, ast.GtE: ANY.ge,
    ast.Is: ANY.is_, ast.IsNot: ANY.is_not,
}  # fmt: skip
MATHS = ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sqrt", "radians", "degrees", "exp",
         "log", "floor", "ceil", "fabs", "hypot")  # fmt: skip
FUNCTIONS: dict[str, Any] = {
    **{name: getattr(math, name) for name in MATHS},
    "pi": math.pi, "e": math.e, "inf": math.inf, "True": True, "False": False, "None": None,
    "str": str, "int": int, "float": float, "bool": bool, "len": len, "abs": abs, "min": min,
    "max": max, "round": round, "list": list, "dict": dict, "sorted": sorted, "sum": sum,
}  # fmt: skip
METHODS: Mapping[type, tuple[str, ...]] = {
    str: ("lower", "upper", "strip", "split", "startswith", "endswith", "replace", "isdigit"),
    dict: ("get", "keys", "values", "items"),
}


def is_xacro(root: XmlNode) -> bool:
    """Return whether a file has elements or arguments of xacro."""
    element = root.element
    if any(NAMESPACE.match(f"{{{uri}}}") for uri in element.nsmap.values()):
        return True
    return any(isinstance(e.tag, str) and NAMESPACE.match(e.tag) for e in element.iter())


def expand(
    root: XmlNode,
    path: Path,
    packages: Sequence[Path] = (),
    arguments: Mapping[str, str] | None = None,
) -> XmlNode:
    """Return the plain URDF of a file.

    Args:
        root, path: the file
        packages: folders of packages, for $(find NAME); those above the file are searched too
        arguments: values of its arguments, {name: value}

    Raises:
        ImportFileError: an element, an expression or a file that cannot be used, in which line
    """
    expansion = _Expansion(path, tuple(packages), dict(arguments or {}))
    made = deepcopy(root.element)
    for child in list(made):
        made.remove(child)
    made.text = None
    scope = _Scope()
    for name, value in root.element.attrib.items():
        made.set(name, str(expansion.text(value, scope, root)))
    expansion.fill(made, root, scope)
    return XmlNode(made, str(path))


@dataclass
class _Scope:
    """Properties, which hide those of the scope outside."""

    outer: _Scope | None = None
    values: dict[str, Any] = field(default_factory=dict[str, Any])
    blocks: dict[str, list[XmlNode]] = field(default_factory=dict[str, "list[XmlNode]"])

    def holder(self, name: str) -> _Scope | None:
        """Return the innermost scope that has a property."""
        scope: _Scope | None = self
        while scope is not None and name not in scope.values:
            scope = scope.outer
        return scope

    def block(self, name: str) -> list[XmlNode] | None:
        """Return a block, None without it."""
        scope: _Scope | None = self
        while scope is not None:
            if name in scope.blocks:
                return scope.blocks[name]
            scope = scope.outer
        return None

    @property
    def root(self) -> _Scope:
        """The outermost scope."""
        return self if self.outer is None else self.outer.root


@dataclass(frozen=True)
class _Unevaluated:
    """A property's text, evaluated when it is used."""

    text: str
    node: XmlNode


@dataclass(frozen=True)
class _Macro:
    """A macro: {parameter: default, None without, "^" or "^|default" of the outer value}."""

    node: XmlNode
    parameters: dict[str, str | None]
    path: Path


class _Expansion:
    def __init__(self, path: Path, packages: tuple[Path, ...], arguments: dict[str, str]) -> None:
        self._path, self._packages = path, packages
        self._arguments = dict(arguments)
        self._macros: dict[str, _Macro] = {}
        self._count = self._depth = 0

    def fill(self, made: Any, source: XmlNode, scope: _Scope) -> None:
        """Append the expanded children of `source` to an element of lxml."""
        self._depth += 1
        if self._depth > MOST_DEPTH:
            raise source.fail(f"is nested more than {MOST_DEPTH} deep: does a macro call itself?")
        for node in source.all_children():
            self._add(made, node, scope)
        self._depth -= 1

    def _add(self, made: Any, node: XmlNode, scope: _Scope) -> None:
        self._count += 1
        if self._count > MOST_ELEMENTS:
            raise node.fail(f"expands to more than {MOST_ELEMENTS} elements")
        match = NAMESPACE.match(node.tag)
        if match is None:
            element = made.makeelement(node.tag)
            element.sourceline = node.element.sourceline
            for key, value in node.attributes().items():
                element.set(key, str(self.text(value, scope, node)))
            element.text = str(self.text(node.text(), scope, node)) or None
            made.append(element)
            self.fill(element, node, scope)
            return
        tag = node.tag[match.end() :]
        if tag in self._macros:
            self._call(made, node, tag, scope)
        elif tag == "macro":
            self._define(node)
        elif tag == "property":
            self._property(node, scope)
        elif tag == "arg":
            name = str(self.text(node.attribute("name"), scope, node))
            if "default" in node.attributes():
                default = str(self.text(node.attribute("default"), scope, node))
                self._arguments.setdefault(name, default)
        elif tag in ("if", "unless"):
            value = self._truth(self.text(node.attribute("value"), scope, node), node)
            if value == (tag == "if"):
                self.fill(made, node, scope)
        elif tag == "include":
            self._include(made, node, scope)
        elif tag == "insert_block":
            name = str(self.text(node.attribute("name"), scope, node))
            block = scope.block(name)
            if block is None:
                raise node.fail(f"names the block {name!r}, which does not exist")
            for inside in block:
                self._add(made, inside, scope)
        else:
            known = ", ".join((*SUPPORTED, *self._macros))
            raise node.fail(f"xacro:{tag} is neither a macro nor supported; known: {known}")

    def _define(self, node: XmlNode) -> None:
        text, found = " ".join(node.attribute("params", "").split()), dict[str, str | None]()
        while text:
            match = PARAMETER.match(text)
            if match is None:
                raise node.fail(f"params: got {text!r}; allowed: names, and name:=default")
            name, outer, default = match.groups()
            found[name] = default if outer is None else f"{outer}{default or ''}"
            text = text[match.end() :]
        self._macros[node.attribute("name").removeprefix("xacro:")] = _Macro(
            node, found, self._path
        )

    def _property(self, node: XmlNode, scope: _Scope) -> None:
        name, kind = node.attribute("name"), node.attribute("scope", "")
        target = {"global": scope.root, "parent": scope.outer or scope}.get(kind, scope)
        value = node.attribute("value", node.attribute("default", "\0"))
        if "value" not in node.attributes() and scope.holder(name) is not None:
            return
        if value == "\0":
            target.blocks[name] = node.all_children()
        elif kind:
            target.values[name] = self.text(value, scope, node)
        else:
            target.values[name] = _Unevaluated(value, node)

    def _include(self, made: Any, node: XmlNode, scope: _Scope) -> None:
        name = str(self.text(node.attribute("filename"), scope, node))
        if "ns" in node.attributes():
            raise node.fail("has a namespace (ns), which is not supported")
        path = Path(name) if Path(name).is_absolute() else self._path.parent / name
        if not is_file(path):
            if node.attribute("optional", "false") in ("1", "true", "True"):
                return
            raise node.fail(f"{name!r} not found (searched {path})")
        before, self._path = self._path, path
        self.fill(made, read_xml(path), scope)
        self._path = before

    def _call(self, made: Any, node: XmlNode, name: str, scope: _Scope) -> None:
        macro, inner = self._macros[name], _Scope(scope)
        given, blocks = node.attributes(), node.all_children()
        for parameter, default in macro.parameters.items():
            if parameter.startswith("*"):
                if not blocks:
                    raise node.fail(f"lacks the block {parameter.lstrip('*')!r}")
                block = blocks.pop(0)
                whole = [block] if not parameter.startswith("**") else block.all_children()
                inner.blocks[parameter.lstrip("*")] = whole
            elif parameter in given:
                inner.values[parameter] = self.text(given.pop(parameter), scope, node)
            elif default is None:
                raise node.fail(f"lacks the parameter {parameter!r}")
            elif default.startswith("^") and scope.holder(parameter) is not None:
                inner.values[parameter] = self._value(parameter, scope, node)
            elif default == "^":
                raise node.fail(f"lacks the parameter {parameter!r}, and no property has its name")
            else:
                text = default.removeprefix("^|")
                inner.values[parameter] = self.text(_unquoted(text), scope, node)
        if given:
            allowed = ", ".join(macro.parameters) or "none"
            raise node.fail(f"has no parameter {min(given)!r}; allowed: {allowed}")
        before, self._path = self._path, macro.path
        self.fill(made, macro.node, inner)
        self._path = before

    def text(self, text: str, scope: _Scope, node: XmlNode) -> Any:
        """Return a text with its expressions replaced; one expression alone keeps its type."""
        whole = PIECE.fullmatch(text.strip())
        if whole is not None and whole[1] is not None:
            return self._evaluate(whole[1], scope, node)

        def replaced(match: re.Match[str]) -> str:
            if match[1] is not None:
                return _written(self._evaluate(match[1], scope, node))
            return "$" if match[2] is None else self._command(match[2], scope, node)

        return PIECE.sub(replaced, text)

    def _command(self, text: str, scope: _Scope, node: XmlNode) -> str:
        command, _, rest = text.strip().partition(" ")
        rest = str(self.text(rest.strip(), scope, node))
        if command == "find":
            places = package_places(rest, self._path.parent, self._packages)
            found = next((place for place in places if place.is_dir()), None)
            if found is None:
                raise node.fail(
                    f"package {rest!r} not found; add its folder with --package-path DIR"
                )
            return str(found.absolute())
        if command == "arg":
            if rest not in self._arguments:
                raise node.fail(f"argument {rest!r} has no value; give --arg {rest}=VALUE")
            return self._arguments[rest]
        if command == "optenv" and " " in rest:
            return rest.partition(" ")[2]
        if command == "dirname":
            return str(self._path.parent.absolute())
        if command == "eval":
            return _written(self._evaluate(rest, scope, node))
        raise node.fail(f"got $({text}); allowed: find, arg, eval, dirname, optenv with a default")

    def _value(self, name: str, scope: _Scope, node: XmlNode) -> Any:
        holder = scope.holder(name)
        if holder is None:
            if name in FUNCTIONS:
                return FUNCTIONS[name]
            raise node.fail(f"names the property {name!r}, which does not exist")
        value = holder.values[name]
        if isinstance(value, _Unevaluated):
            self._depth += 1
            if self._depth > MOST_DEPTH:
                raise node.fail(f"property {name!r} refers to itself")
            value = self.text(value.text, holder, value.node)
            self._depth -= 1
            holder.values[name] = value
        return _literal(value) if isinstance(value, str) else value

    def _evaluate(self, text: str, scope: _Scope, node: XmlNode) -> Any:
        inside = PIECE.sub(
            lambda m: m[0] if m[2] is None else self._command(m[2], scope, node), text
        )
        try:
            tree = ast.parse(" ".join(inside.split()), mode="eval")
            return self._node(tree.body, scope, node)
        except (SyntaxError, ValueError, TypeError, ArithmeticError, LookupError) as problem:
            raise node.fail(f"${{{text}}} cannot be evaluated: {problem}") from problem

    def _node(self, tree: ast.expr, scope: _Scope, at: XmlNode) -> Any:
        def of(inside: ast.expr) -> Any:
            return self._node(inside, scope, at)

        match tree:
            case ast.Constant():
                return tree.value
            case ast.Name():
                return self._value(tree.id, scope, at)
            case ast.List() | ast.Tuple():
                return [of(one) for one in tree.elts]
            case ast.Dict():
                return {of(k): of(v) for k, v in zip(tree.keys, tree.values, strict=True) if k}
            case ast.UnaryOp():
                return OPERATORS[type(tree.op)](of(tree.operand))
            case ast.BinOp():
                return _binary(tree.op, of(tree.left), of(tree.right))
            case ast.BoolOp():
                value = of(tree.values[0])
                for one in tree.values[1:]:
                    if bool(value) == isinstance(tree.op, ast.Or):
                        break
                    value = of(one)
                return value
            case ast.Compare():
                left = of(tree.left)
                for kind, right in zip(tree.ops, map(of, tree.comparators), strict=True):
                    if isinstance(kind, ast.In | ast.NotIn):
                        holds = (left in right) == isinstance(kind, ast.In)
                    else:
                        holds = bool(OPERATORS[type(kind)](left, right))
                    if not holds:
                        return False
                    left = right
                return True
            case ast.IfExp():
                return of(tree.body) if of(tree.test) else of(tree.orelse)
            case ast.Subscript():
                if isinstance(tree.slice, ast.Slice):
                    ends = (tree.slice.lower, tree.slice.upper, tree.slice.step)
                    return of(tree.value)[slice(*(None if e is None else of(e) for e in ends))]
                return of(tree.value)[of(tree.slice)]
            case ast.Attribute():
                return of(tree.value)[tree.attr]
            case ast.Call(keywords=[]):
                return self._called(tree.func, [of(one) for one in tree.args], scope, at)
            case _:
                raise ValueError(f"{ast.unparse(tree)!r} is not supported")

    def _called(self, called: ast.expr, values: list[Any], scope: _Scope, at: XmlNode) -> Any:
        name = ast.unparse(called).removeprefix("xacro.").removeprefix("math.")
        if name == "load_yaml":
            return self._yaml(str(values[0]), at)
        if name in ("message", "warning", "fatal", "print_location"):
            if name == "fatal":
                raise at.fail(" ".join(map(str, values)))
            return None
        if name in FUNCTIONS and callable(FUNCTIONS[name]):
            return FUNCTIONS[name](*values)
        if isinstance(called, ast.Attribute):
            owner = self._node(called.value, scope, at)
            if any(isinstance(owner, k) and called.attr in names for k, names in METHODS.items()):
                return getattr(owner, called.attr)(*values)
        raise ValueError(f"function {name!r} is not supported")

    def _yaml(self, name: str, node: XmlNode) -> Any:
        path = Path(name) if Path(name).is_absolute() else self._path.parent / name
        try:
            return yaml.safe_load(read_input(path, MOST_YAML))
        except (OSError, yaml.YAMLError) as problem:
            raise node.fail(f"{path} cannot be read: {problem}") from problem

    def _truth(self, value: Any, node: XmlNode) -> bool:
        value = _literal(value) if isinstance(value, str) else value
        if isinstance(value, str):
            raise node.fail(f"value: got {value!r}; allowed: true, false or a number")
        return bool(value)


def _binary(kind: ast.operator, left: Any, right: Any) -> Any:
    if isinstance(kind, ast.Add) and not isinstance(left, int | float):
        if len(left) + len(right) > MOST_TEXT:
            raise ValueError(f"a text of more than {MOST_TEXT} characters")
        return left + right
    left, right = _number(left), _number(right)
    if isinstance(kind, ast.Mult):
        return left * right
    if isinstance(kind, ast.Pow):
        if abs(right) > MOST_POWER:
            raise ValueError(f"exponent {right:g}; allowed: up to {MOST_POWER:g}")
        return left**right
    return OPERATORS[type(kind)](left, right)


def _number(value: Any) -> int | float:
    if not isinstance(value, int | float) or abs(value) > 1e100:
        raise ValueError(f"got {value!r} where a number is needed")
    return value


def _unquoted(text: str) -> str:
    quoted = len(text) > 1 and text[0] == text[-1] and text[0] in "'\""
    return text[1:-1] if quoted else text


def _literal(text: str) -> Any:
    """Return a property's text as a number or a truth value where it is one."""
    stripped = text.strip()
    if stripped.lower() in ("true", "false"):
        return stripped.lower() == "true"
    if "_" not in stripped:
        for kind in (int, float):
            try:
                return kind(stripped)
            except ValueError:
                continue
    return _unquoted(text)


def _written(value: Any) -> str:
    return repr(value) if isinstance(value, float) else str(value)
