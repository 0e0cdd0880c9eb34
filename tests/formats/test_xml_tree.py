"""XML of exports: the same bytes each time, numbers without noise."""

from __future__ import annotations

import pytest

from trocar.formats.xml_tree import child, document, element, number, numbers

pytest.importorskip("lxml", reason="exports need the extra 'export'")


def test_a_document_is_indented_by_two_spaces_and_ends_with_a_newline() -> None:
    root = element("robot", {"name": "a"})
    child(child(root, "link", {"name": "b"}), "note", text="1 < 2")
    assert document(root, "made by hand -- once") == (
        b'<?xml version="1.0" encoding="utf-8"?>\n'
        b"<!-- made by hand - once -->\n"
        b'<robot name="a">\n  <link name="b">\n    <note>1 &lt; 2</note>\n  </link>\n</robot>\n'
    )


def test_numbers_have_twelve_digits_no_noise_and_no_negative_zero() -> None:
    assert numbers([1 / 3, -0.0, 1e-17, -1.6e-16, 1e-9]) == "0.333333333333 0 0 0 1e-09"
    assert number(-0.0) == "0"
    assert number(1 / 3, 17) == "0.33333333333333331"
