"""Texts of calibration files as keys and values: YAML, JSON, OpenCV's XML, ROS's INI.

Matrices are lists, or {rows, cols, data}; a file of ROS's INI may hold two cameras.

Source: OpenCV 4, core, FileStorage (YAML, XML, JSON); ROS, camera_calibration_parsers (YAML, INI,
"oST version 5.0 parameters") and camera_calibration, which writes one INI text of both eyes.
"""

from __future__ import annotations

import json
import re
from functools import lru_cache
from typing import Any, cast
from xml.etree import ElementTree

from trocar.errors import DescriptionError
from trocar.inputs import excess_of, got

Keys = dict[str, Any]

#: Numbers with brackets, commas and white space, as people print arrays.
NUMBERS = re.compile(r"[\s\[\](),;0-9.eE+-]*\d[\s\[\](),;0-9.eE+-]*")
#: Keys of ROS's INI, and those of its YAML.
INI_KEYS = {
    "width": "image_width",
    "height": "image_height",
    "camera matrix": "camera_matrix",
    "distortion": "distortion_coefficients",
    "rectification": "rectification_matrix",
    "projection": "projection_matrix",
}


def parse_ini(text: str, file: str) -> list[Keys]:
    """Return the keys and values of each camera in a text of ROS's INI.

    Raises:
        DescriptionError: a line that is neither section, key nor numbers; file and line are named
    """
    cameras: list[Keys] = []
    key = ""
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if not line or line[0] in "#;":
            continue
        if line[0] == "[" and line[-1] == "]" and not NUMBERS.fullmatch(line):
            section, key = line[1:-1].strip(), ""
            if section == "image" or not cameras:
                cameras.append({})
            if section not in ("image", "externals"):
                cameras[-1]["camera_name"] = section
        elif NUMBERS.fullmatch(line) and key:
            cameras[-1].setdefault(key, []).extend(numbers_of(line))
        elif re.fullmatch(r"[A-Za-z][\w ]*", line) and cameras:
            key = INI_KEYS.get(line.lower(), line)
        else:
            allowed = "[section], a key (width, camera matrix, ...) or numbers below a key"
            raise DescriptionError(file, f"line {number}", got(line[:80], allowed))
    if not any(cameras):
        raise DescriptionError(file, "", "is empty; allowed: a camera's calibration in ROS's INI")
    for camera in cameras:
        for name in ("image_width", "image_height"):
            if len(camera.get(name, ())) == 1:
                camera[name] = camera[name][0]
    return cameras


def parse_xml(text: str, file: str) -> Keys:
    """Return keys and values of a file of OpenCV's XML.

    Raises:
        DescriptionError: it is no XML, or has another root than opencv_storage
    """
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text):
        raise DescriptionError(file, "", "has a <!DOCTYPE>; allowed: OpenCV's XML without one")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as problem:
        where = f"line {problem.position[0]}"
        raise DescriptionError(file, where, f"is not XML: {problem}") from problem
    if root.tag != "opencv_storage":
        raise DescriptionError(file, "", f"has the root <{root.tag}>; allowed: <opencv_storage>")
    found = _element(root)
    if excess := excess_of(found):
        raise DescriptionError(file, "", excess)
    if not isinstance(found, dict):
        raise DescriptionError(file, "", "is empty; allowed: a camera's calibration in XML")
    return cast(Keys, found)


def _element(node: ElementTree.Element) -> Any:
    """Return an element's value: a table, a list, a number, numbers or a text."""
    children = list(node)
    if children and all(child.tag == "_" for child in children):
        return [_element(child) for child in children]
    if children:
        return {child.tag: _element(child) for child in children}
    text = (node.text or "").strip()
    if not NUMBERS.fullmatch(text):
        return text.strip('"')
    found = numbers_of(text)
    return found[0] if len(found) == 1 and node.tag != "data" else found


def parse_json(text: str, file: str) -> Keys:
    """Return keys and values of a JSON file.

    Raises:
        DescriptionError: it is no JSON, or holds no keys; file and line are named
    """
    try:
        value = json.loads(text)
    except json.JSONDecodeError as problem:
        raise DescriptionError(
            file, f"line {problem.lineno}", f"is not JSON: {problem.msg}"
        ) from problem
    except RecursionError as problem:
        raise DescriptionError(file, "", "is not JSON: is nested too deeply") from problem
    if excess := excess_of(value):
        raise DescriptionError(file, "", excess)
    if not isinstance(value, dict):
        raise DescriptionError(file, "", got(value, "keys with values"))
    return cast(Keys, value)


def numbers_of(text: str) -> list[Any]:
    """Return the numbers in a text, and as texts the words that are not numbers."""
    found: list[Any] = []
    for word in re.split(r"[\s\[\](),;]+", text.strip(" \t\r\n[](),;")):
        try:
            value = float(word)
            found.append(int(value) if re.fullmatch(r"[-+]?\d+", word) else value)
        except ValueError:
            found.append(word)
    return found


def parse_yaml(text: str, file: str) -> Keys:
    """Return keys and values of a YAML file, of the first document where it has several.

    Raises:
        DescriptionError: it is no YAML, empty, or holds no keys; file and line are named
    """
    import yaml  # takes 10 ms; presets need none

    try:
        # OpenCV writes "%YAML:1.0", which is not YAML's "%YAML 1.0", and reads "data:[1, 2]" and
        # "width:640", which YAML takes for words; lines keep their numbers.
        text = re.sub(r"^%YAML:", "#", text)
        text = re.sub(r"^([ \t]*[\w.]+):(?=[-\d.\[])", r"\1: ", text, flags=re.MULTILINE)
        documents: list[object] = list(yaml.load_all(text, _loader()))
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark
        where = f"line {mark.line + 1}" if mark is not None else ""
        raise DescriptionError(file, where, f"is not YAML: {problem.problem}") from problem
    except RecursionError as problem:
        raise DescriptionError(file, "", "is not YAML: is nested too deeply") from problem
    except (yaml.YAMLError, ValueError) as problem:
        reason = str(problem).partition("\n")[0]
        raise DescriptionError(file, "", f"is not YAML: {reason}") from problem
    value = documents[0] if documents else None
    if excess := excess_of(value):
        raise DescriptionError(file, "", excess)
    if value is None:
        raise DescriptionError(file, "", "is empty; allowed: a camera's calibration in YAML")
    if not isinstance(value, dict):
        raise DescriptionError(file, "", got(value, "keys with values"))
    return cast(Keys, value)


@lru_cache(maxsize=1)
def _loader() -> Any:
    """Return PyYAML's safe loader with OpenCV's tags and without repeated keys."""
    import yaml

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent: Any, index: Any) -> Any:
            events: Any = self  # its methods have no types
            if events.check_event(yaml.AliasEvent):  # a few stand for any amount of data
                raise yaml.MarkedYAMLError(
                    None, None, "has an alias (*name)", events.peek_event().start_mark
                )
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            seen: set[str] = set()
            for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
                name = str(key.value)
                if name in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"has {name!r} a second time", key.start_mark
                    )
                seen.add(name)
            return super().construct_mapping(node, deep)

    extended: Any = Loader  # its methods have no types
    extended.add_multi_constructor("tag:yaml.org,2002:opencv-", _tagged_mapping)
    # Python writes 1e-05, a number in YAML 1.2 and a text in PyYAML's YAML 1.1.
    number = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")
    extended.add_implicit_resolver("tag:yaml.org,2002:float", number, list("-+.0123456789"))
    return extended


def _tagged_mapping(loader: Any, suffix: str, node: Any) -> Any:
    """Return OpenCV's tagged matrix as if it had no tag."""
    del suffix
    return loader.construct_mapping(node, deep=True)
