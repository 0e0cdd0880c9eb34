"""Answers to service calls."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.topics import Service


def answer(
    core: Core,  # noqa: ARG001  the questions that need it come next
    service: Service,
    request: dict[str, Any],  # noqa: ARG001
    timeout_s: float = 5.0,  # noqa: ARG001
) -> dict[str, Any]:
    """Answer a call.

    Raises:
        InputError: what is wrong with the request, or no answer in time
    """
    if service.key == "crtk_version":
        return {"success": True, "message": "1.1.0"}
    raise InputError(f"{service.name}: is not answered yet")
