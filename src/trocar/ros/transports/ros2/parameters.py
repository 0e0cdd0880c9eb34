"""The parameter services of a node, as `ros2 param` and rclpy's and rclcpp's clients call them.

Source: rcl_interfaces (Jazzy), msg/ and srv/.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.ros.parameters import MODEL, Parameters, Value
from trocar.ros.transports.ros2.naming import typestore

GIVEN = "rcl_interfaces/Parameter[] parameters"
#: Service -> its request and its response.
SERVICES = {
    "GetParameters": ("string[] names", "rcl_interfaces/ParameterValue[] values"),
    "GetParameterTypes": ("string[] names", "uint8[] types"),
    "ListParameters": (
        "string[] prefixes\nuint64 depth",
        "rcl_interfaces/ListParametersResult result",
    ),
    "DescribeParameters": ("string[] names", "rcl_interfaces/ParameterDescriptor[] descriptors"),
    "SetParameters": (GIVEN, "rcl_interfaces/SetParametersResult[] results"),
    "SetParametersAtomically": (GIVEN, "rcl_interfaces/SetParametersResult result"),
}
# ParameterType. Source: rcl_interfaces/msg/ParameterType.msg.
NOT_SET, BOOL, INTEGER, DOUBLE, STRING = range(5)
MESSAGES = "rcl_interfaces/msg/"


@cache
def _store() -> Any:
    """Return Jazzy's types, with those of the services."""
    from rosbags.typesys import get_types_from_msg

    store = typestore("ROS2_JAZZY")
    types: dict[str, Any] = {}
    for name, halves in SERVICES.items():
        for half, text in zip(("Request", "Response"), halves, strict=True):
            types.update(get_types_from_msg(text, f"rcl_interfaces/srv/{name}_{half}"))
    store.register({name.replace("/srv/msg/", "/srv/"): found for name, found in types.items()})
    return store


def service_type(name: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return the DDS name and the hash of a service's request and of its response."""
    kinds = [f"rcl_interfaces/srv/{name}_{half}" for half in ("Request", "Response")]
    request, response = [
        (f"rcl_interfaces::srv::dds_::{kind.rpartition('/')[2]}_", _store().hash_rihs01(kind))
        for kind in kinds
    ]
    return request, response


def answering(name: str, parameters: Parameters) -> Callable[[bytes], bytes]:
    """Return the function that answers a service of `SERVICES`: CDR in, CDR out."""
    store = _store()
    request, response = [f"rcl_interfaces/srv/{name}_{half}" for half in ("Request", "Response")]

    def answer(payload: bytes) -> bytes:
        fields = ANSWERS[name](parameters, store.deserialize_cdr(payload, request))
        return bytes(store.serialize_cdr(store.types[response](fields), response))

    return answer


def _type_of(value: Value | None) -> int:
    if value is None:
        return NOT_SET
    return BOOL if isinstance(value, bool) else STRING if isinstance(value, str) else DOUBLE


def _value(value: Value | None) -> Any:
    kind = _type_of(value)
    return _store().types[f"{MESSAGES}ParameterValue"](
        type=kind,
        bool_value=kind == BOOL and bool(value),
        integer_value=0,
        double_value=float(value or 0.0) if kind == DOUBLE else 0.0,
        string_value=str(value) if kind == STRING else "",
        byte_array_value=np.empty(0, np.uint8),
        bool_array_value=np.empty(0, np.bool_),
        integer_array_value=np.empty(0, np.int64),
        double_array_value=np.empty(0),
        string_array_value=[],
    )


def _get(parameters: Parameters, request: Any) -> list[Any]:
    return [_value(value) for value in parameters.read(request.names).values()]


def _types(parameters: Parameters, request: Any) -> NDArray[np.uint8]:
    # the model is a string, whether it can be made or not
    others = parameters.read(name for name in request.names if name != MODEL)
    found = {name: _type_of(value) for name, value in others.items()} | {MODEL: STRING}
    return np.array([found[name] for name in request.names], np.uint8)


def _list(parameters: Parameters, request: Any) -> Any:
    depth = request.depth or 1 << 32
    prefixes = tuple(f"{prefix}." for prefix in request.prefixes)

    def listed(name: str) -> bool:
        own = [prefix for prefix in prefixes if name.startswith(prefix)]
        rest = name.removeprefix(max(own, key=len)) if own else name
        inside = not prefixes or bool(own) or name in request.prefixes
        return inside and rest.count(".") < depth

    names = [name for name in parameters.names() if listed(name)]
    roots = sorted({name.rpartition(".")[0] for name in names} - {""})
    return _store().types[f"{MESSAGES}ListParametersResult"](names=names, prefixes=roots)


def _describe(parameters: Parameters, request: Any) -> list[Any]:
    described = _store().types[f"{MESSAGES}ParameterDescriptor"]
    return [
        described(
            name=name,
            type=int(kind),
            description="" if kind != DOUBLE else "gain of the joint's controller, 0 or more",
            additional_constraints="",
            read_only=kind != DOUBLE,
            dynamic_typing=False,
            floating_point_range=[],
            integer_range=[],
        )
        for name, kind in zip(request.names, _types(parameters, request), strict=True)
    ]


def _given(value: Any) -> object:
    """Return the value of a ParameterValue; only numbers can be set."""
    values = {BOOL: value.bool_value, INTEGER: value.integer_value, STRING: value.string_value}
    return values.get(value.type, value.double_value if value.type == DOUBLE else None)


def _set(parameters: Parameters, request: Any) -> list[Any]:
    return [_result(parameters.write(p.name, _given(p.value))) for p in request.parameters]


def _set_atomically(parameters: Parameters, request: Any) -> Any:
    given = {p.name: _given(p.value) for p in request.parameters}
    problem = next(filter(None, (parameters.problem(*one) for one in given.items())), "")
    for name, value in given.items() if not problem else ():
        parameters.write(name, value)
    return _result(problem)


def _result(problem: str) -> Any:
    return _store().types[f"{MESSAGES}SetParametersResult"](not problem, problem)


ANSWERS: dict[str, Callable[[Parameters, Any], Any]] = {
    "GetParameters": _get,
    "GetParameterTypes": _types,
    "ListParameters": _list,
    "DescribeParameters": _describe,
    "SetParameters": _set,
    "SetParametersAtomically": _set_atomically,
}
