"""The services that ask about the others: `/rosapi/...`, as rosbridge's rosapi node has them.

Source: rosbridge_suite, rosapi_msgs (ROS 1 and 2 agree in the fields that stand here).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from trocar.errors import InputError
from trocar.interfaces.crtk.messages import MessageType, message_type, service_type
from trocar.interfaces.crtk.topics import Service, Topic
from trocar.interfaces.crtk.transports.websocket.names import plain, same_type
from trocar.interfaces.crtk.transports.websocket.typedefs import typedefs

PREFIX = "rosapi/"
NODE = "/trocar"
"""Who publishes and serves everything."""


@dataclass(frozen=True)
class Catalogue:
    """What there is to ask about.

    Args:
        topics: by name without a leading slash, in the order of the table
        services: likewise
        now: returns the time of the newest stamp, (s, ns)
    """

    topics: Mapping[str, Topic]
    services: Mapping[str, Service]
    now: Callable[[], tuple[int, int]]


Reply = Callable[[Catalogue, str], dict[str, Any]]


def ask(service: str, args: Mapping[str, Any] | list[Any], of: Catalogue) -> dict[str, Any]:
    """Answer one of the services.

    Args:
        service: name without a leading slash, such as "rosapi/topics"
        args: by name, or in a list; each takes one at most

    Raises:
        InputError: there is no such service, topic or type
    """
    found = ANSWERS.get(service.removeprefix(PREFIX))
    if found is None:
        known = ", ".join(PREFIX + name for name in ANSWERS)
        raise InputError(f"no service {service!r}; of rosapi there are {known}")
    key, reply = found
    return reply(of, _argument(service, key, args))


def _argument(service: str, key: str, args: Mapping[str, Any] | list[Any]) -> str:
    value = args.get(key, "") if isinstance(args, Mapping) else next(iter(args), "")
    if not isinstance(value, str):
        raise InputError(f"{service}: {key}: got a {type(value).__name__}; allowed: a name")
    return value


def _topics(of: Catalogue, _: str) -> dict[str, Any]:
    return {"topics": [f"/{n}" for n in of.topics], "types": [t.type for t in of.topics.values()]}


def _raw_types(of: Catalogue, _: str) -> dict[str, Any]:
    texts = [message_type(topic.type).text_ros1 for topic in of.topics.values()]
    return {**_topics(of, ""), "typedefs_full_text": texts}


def _topic_type(of: Catalogue, name: str) -> dict[str, Any]:
    topic = of.topics.get(plain(name))
    return {"type": "" if topic is None else topic.type}


def _topics_for_type(of: Catalogue, kind: str) -> dict[str, Any]:
    return {"topics": [f"/{n}" for n, t in of.topics.items() if same_type(kind, t.type)]}


def _services(of: Catalogue, _: str) -> dict[str, Any]:
    return {"services": [*(f"/{n}" for n in of.services), *(f"/{PREFIX}{n}" for n in ANSWERS)]}


def _service_type(of: Catalogue, name: str) -> dict[str, Any]:
    service = of.services.get(plain(name))
    return {"type": "" if service is None else service.type}


def _services_for_type(of: Catalogue, kind: str) -> dict[str, Any]:
    return {"services": [f"/{n}" for n, s in of.services.items() if same_type(kind, s.type)]}


def _node_details(of: Catalogue, node: str) -> dict[str, Any]:
    if plain(node) != plain(NODE):
        return {"subscribing": [], "publishing": [], "services": []}
    heard = [f"/{n}" for n, t in of.topics.items() if t.direction == "sub"]
    told = [f"/{n}" for n, t in of.topics.items() if t.direction == "pub"]
    return {"subscribing": heard, "publishing": told, "services": _services(of, "")["services"]}


def _nodes_of(key: str, direction: str) -> Reply:
    def nodes(of: Catalogue, name: str) -> dict[str, Any]:
        topic = of.topics.get(plain(name))
        return {key: [NODE] if topic is not None and topic.direction == direction else []}

    return nodes


def _time(of: Catalogue, _: str) -> dict[str, Any]:
    seconds, nanoseconds = of.now()
    return {"time": {"secs": seconds, "nsecs": nanoseconds}}


def _service_node(of: Catalogue, name: str) -> dict[str, Any]:
    return {"node": NODE if plain(name) in of.services else ""}


def _types(find: Callable[[str], MessageType]) -> Reply:
    return lambda _, kind: {"typedefs": typedefs(find(kind))}


def _always(**values: object) -> Reply:
    return lambda _of, _name: values


ANSWERS: Mapping[str, tuple[str, Reply]] = {
    "topics": ("", _topics),
    "topics_and_raw_types": ("", _raw_types),
    "topics_for_type": ("type", _topics_for_type),
    "topic_type": ("topic", _topic_type),
    "publishers": ("topic", _nodes_of("publishers", "pub")),
    "subscribers": ("topic", _nodes_of("subscribers", "sub")),
    "services": ("", _services),
    "services_for_type": ("type", _services_for_type),
    "service_type": ("service", _service_type),
    "service_node": ("service", _service_node),
    "nodes": ("", _always(nodes=[NODE])),
    "node_details": ("node", _node_details),
    "message_details": ("type", _types(message_type)),
    "service_request_details": ("type", _types(lambda kind: service_type(kind).request)),
    "service_response_details": ("type", _types(lambda kind: service_type(kind).response)),
    "action_servers": ("", _always(action_servers=[])),
    "get_param_names": ("", _always(names=[])),
    "has_param": ("name", _always(exists=False)),
    "get_param": ("name", _always(value="null")),
    "get_time": ("", _time),
}
"""Service -> the name of its argument ("" for none), and what answers it."""
