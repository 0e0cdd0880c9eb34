"""COLLADA files with references that lead nowhere, mended so that a reader keeps their triangles.

pycollada leaves out a node whose material, image or scene is missing, with all of its triangles.
Exporters write such files: textures without a file, scenes that are never instanced, meshes that
only a skin uses.

Source: Khronos, COLLADA 1.4.1 and 1.5.0 specifications.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from trocar.formats.links import ImportFileError

#: Elements of numbers, and a decimal comma in one.
NUMBERS = (
    *("float_array", "matrix", "translate", "rotate", "scale", "lookat", "skew", "color", "float"),
    "bind_shape_matrix",
)
COMMA = re.compile(r"(?<=\d),(?=\d)")
#: Shading models of an effect's common profile.
SHADERS = ("constant", "lambert", "phong", "blinn")


def mended_collada(path: Path) -> tuple[bytes, list[str]]:
    """Read a COLLADA file, its broken references taken out.

    Args:
        path: of the file

    Returns:
        the document, and notes of what it lacks

    Raises:
        ImportFileError: it is no XML
    """
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except ElementTree.ParseError as problem:
        raise ImportFileError(str(path), f"is no XML: {problem}") from None
    file = _Document(root)
    notes = [*file.mend_commas(), *file.mend_images(), *file.mend_materials()]
    file.instance_skins()
    file.instance_scene()
    if file.namespace:
        ElementTree.register_namespace("", file.namespace)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True), notes


class _Document:
    """A document under repair.

    Args:
        root: its root, changed in place
    """

    def __init__(self, root: Element) -> None:
        self.root = root
        self.namespace = root.tag[1:].partition("}")[0] if root.tag.startswith("{") else ""
        self._colourless = set[str]()  # effects whose colour was a texture that is missing
        self._parent = {inside: outside for outside in root.iter() for inside in outside}

    def _tag(self, name: str) -> str:
        return f"{{{self.namespace}}}{name}" if self.namespace else name

    def _all(self, name: str, within: Element | None = None) -> list[Element]:
        return list((self.root if within is None else within).iter(self._tag(name)))

    def _find(self, within: Element, *names: str) -> Element | None:
        return within.find("/".join(map(self._tag, names)))

    def _remove(self, element: Element) -> None:
        self._parent[element].remove(element)

    def _make(self, name: str, within: Element, **attributes: str) -> Element:
        made = ElementTree.SubElement(within, self._tag(name), attributes)
        self._parent[made] = within
        return made

    def mend_commas(self) -> Iterator[str]:
        """Write decimal commas as points: programs of some languages save them."""
        found = [e for name in NUMBERS for e in self._all(name) if COMMA.search(e.text or "")]
        for inside in found:
            inside.text = COMMA.sub(".", inside.text or "")
        if found:
            yield "decimal commas read as points"

    def mend_images(self) -> Iterator[str]:
        """Take out images without a file, and what refers to them."""
        images = set[str]()
        for image in self._all("image"):
            init = self._find(image, "init_from")
            ref = self._find(image, "init_from", "ref")  # COLLADA 1.5
            if init is not None and ref is not None:
                init.remove(ref)
                init.text = ref.text
            if init is None or not (init.text or "").strip():
                self._remove(image)
                yield f"image {image.get('id', '')!r} names no file: drawn without it"
            else:
                images.add(image.get("id", ""))
        for effect in self._all("effect"):
            self._mend_textures(effect, images)

    def _mend_textures(self, effect: Element, images: set[str]) -> None:
        """Keep an effect's textures of known images; its other properties stay."""
        surfaces, samplers = dict[str, str](), dict[str, str]()
        params = self._all("newparam", effect)
        for kind, found in (("surface", surfaces), ("sampler2D", samplers)):
            for param in params:
                inside = self._find(param, kind)
                if inside is None:
                    continue
                image = self._image_of(inside, surfaces)
                if image in images:
                    found[param.get("sid", "")] = image
                else:
                    self._remove(param)
                if kind == "sampler2D" and self._find(inside, "source") is None:
                    self._remove(param)  # COLLADA 1.5: the texture then names the image itself
        for texture in self._all("texture", effect):
            name = texture.get("texture", "")
            if name in images or name in samplers:
                direct = name in images or self._missing(effect, name)
                texture.set("texture", samplers.get(name, name) if direct else name)
            else:
                self._remove(texture)
        for shader in (found for name in SHADERS for found in self._all(name, effect)):
            for prop in [prop for prop in shader if not len(prop)]:
                shader.remove(prop)
                if prop.tag == self._tag("diffuse"):
                    self._colourless.add(effect.get("id", ""))

    def _image_of(self, inside: Element, surfaces: dict[str, str]) -> str:
        """Return the image that a surface or sampler shows, "" without one."""
        init, source = self._find(inside, "init_from"), self._find(inside, "source")
        direct = self._find(inside, "instance_image")
        if source is not None:
            return surfaces.get((source.text or "").strip(), "")
        if direct is not None:
            return direct.get("url", "").removeprefix("#")
        return "" if init is None else (init.text or "").strip()

    def _missing(self, effect: Element, sid: str) -> bool:
        return all(param.get("sid") != sid for param in self._all("newparam", effect))

    def mend_materials(self) -> Iterator[str]:
        """Take out bindings of materials that do not exist, or have no common profile."""
        effects = {
            effect.get("id", "")
            for effect in self._all("effect")
            if any(self._all(shader, effect) for shader in SHADERS)
        }
        shown = dict[str, str]()
        for material in self._all("material"):
            instance = self._find(material, "instance_effect")
            url = "" if instance is None else instance.get("url", "")
            shown[material.get("id", "")] = url.removeprefix("#")
        missing = dict[str, None]()
        for bound in self._all("instance_material"):
            name = bound.get("target", "").removeprefix("#")
            if shown.get(name) in self._colourless:
                self._remove(bound)
            elif shown.get(name) not in effects:
                missing[name] = None
                self._remove(bound)
        for name in missing:
            yield f"material {name!r} not found: drawn without its colour"

    def instance_skins(self) -> None:
        """Show the mesh of each skin, in the pose in which it was bound."""
        skins = {
            controller.get("id", ""): skin
            for controller in self._all("controller")
            if (skin := self._find(controller, "skin")) is not None
        }
        for instance in self._all("instance_controller"):
            skin = skins.get(instance.get("url", "").removeprefix("#"))
            if skin is None:
                continue
            node = self._make("node", self._parent[instance])
            shape = self._find(skin, "bind_shape_matrix")
            if shape is not None:
                self._make("matrix", node).text = shape.text
            shown = self._make("instance_geometry", node, url=skin.get("source", ""))
            if (binding := self._find(instance, "bind_material")) is not None:
                shown.append(binding)
            self._remove(instance)

    def instance_scene(self) -> None:
        """Show the first scene where none is shown, or all geometries of a file without scenes."""
        scenes = self._all("visual_scene")
        shown = {found.get("url", "").removeprefix("#") for found in
                 self._all("instance_visual_scene")}  # fmt: skip
        if any(scene.get("id") in shown for scene in scenes):
            return
        if not scenes:
            scenes = [self._make("visual_scene", self._make("library_visual_scenes", self.root))]
            for geometry in self._all("geometry"):
                node = self._make("node", scenes[0])
                self._make("instance_geometry", node, url=f"#{geometry.get('id', '')}")
        scenes[0].set("id", scenes[0].get("id") or "scene")
        for old in self._all("scene"):
            self._remove(old)
        self._make(
            "instance_visual_scene", self._make("scene", self.root), url=f"#{scenes[0].get('id')}"
        )
