# SPDX-License-Identifier: Apache-2.0
"""Write the pages of docs/reference from the code: parameters, topics, messages, commands, diagnostics, Python API."""

import ast
import inspect
import json
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

import scara_effmass
from scara_effmass.cli.commands import COMMANDS
from scara_effmass.nodes.lifecycle import AnyNode, LifecycleBase

ROOT = Path(__file__).resolve().parents[1]
VARIANTS = {
    "monitor": ("", "await_robot_description:=true", "command_tolerance:=0.1", "payload_topic:=payload"),
    "daq": ("source:=sim",),
    "sim": ("", "clock:=true"),
}
"""Parameters that add endpoints to a node."""
NAMESPACE = "/cell/"
FOREVER_S = 1e9
PARAMETERS = """\
Generated from the nodes; `ros2 param describe` shows the same. Read-only parameters change
only while the node is unconfigured, `autostart` only at the start.
Every node also has ROS's own `use_sim_time`, and `qos_overrides.*` for its publishers and subscriptions."""
TOPICS = """\
Generated from the nodes. Names without a leading `/` follow the namespace of the node and can be remapped. History is
always keep-last. Every node also has the services of ROS lifecycle nodes and parameters."""
COMMAND_LINE = """\
Generated from the command line: `scara-effmass COMMAND --help` prints the same. [Commands in detail](../commands.md)
has exit codes, tables and files."""
DIAGNOSTICS = """\
Generated from the nodes. Each status on `/diagnostics` is named `/NODE: STATUS`; … stands for a name. Every node
publishes once a second, the monitor also when a verdict changes. The first status of a node also has
`incompatible QoS`."""
API = "Generated from the docstrings."


def main() -> None:
    """Write the pages."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    parameters, topics = [], []
    for kind in _node_kinds():
        with _node(kind, "") as node:
            settings = VARIANTS.get(node.get_name(), ("",))
            title = f"## {node.get_name()}_node"
            parameters += [title, *_parameters(node)]
        entries: dict[str, str] = {}
        for setting in settings:
            condition = f" With `{setting.partition(':=')[0]}`." if entries else ""
            with _node(kind, setting) as node:
                node.configure()
                entries = dict.fromkeys(_endpoints(node), condition) | entries
        topics += [title, *(f"{entry}{condition}" for entry, condition in sorted(entries.items()))]
    messages = map(_message, sorted((ROOT / "msg_schemas/msg").glob("*.msg")))
    _write("Parameters", PARAMETERS, *parameters)
    _write("Topics and services", TOPICS, *topics)
    _write("Messages", "Generated from `msg_schemas/msg`.", *messages)
    _write("Commands and options", COMMAND_LINE, *map(_command, COMMANDS))
    _write("Diagnostics", DIAGNOSTICS, *_diagnostics())
    _write("Python API", API, *map(_api, scara_effmass.__all__))


def _write(title: str, *sections: str) -> None:
    folder = ROOT / "docs/reference"
    folder.mkdir(exist_ok=True)
    text = "\n\n".join((f"# {title}", *sections, ""))
    (folder / f"{title.split(maxsplit=1)[0].lower()}.md").write_text(text, encoding="utf-8")


def _node_kinds() -> Iterator[type[AnyNode]]:
    for path in sorted((ROOT / "scara_effmass/nodes").glob("*_node.py")):
        module = import_module(f"scara_effmass.nodes.{path.stem}")
        kinds = [kind for _, kind in inspect.getmembers(module, inspect.isclass) if kind.__module__ == module.__name__]
        yield from (kind for kind in kinds if issubclass(kind, LifecycleBase))


@contextmanager
def _node(kind: type[AnyNode], setting: str) -> Iterator[AnyNode]:
    """Yield a node whose parameter `setting` is set."""
    parameters = ["-p", setting] if setting else []
    rclpy.init(args=["--ros-args", "--log-level", "error", "-r", f"__ns:={NAMESPACE[:-1]}", *parameters])
    node = kind()
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown()


def _parameters(node: AnyNode) -> Iterator[str]:
    node.set_read_only(read_only=True)  # as of a configured node
    for name, parameter in node.get_parameters_by_prefix("").items():
        descriptor: ParameterDescriptor = node.describe_parameter(name)
        if not descriptor.description or name.startswith(("qos_overrides.", "use_sim_time", "start_type_")):
            continue
        unit = re.search(r" \[([^\]]*)\]", descriptor.description)
        details = (
            Parameter.Type(descriptor.type).name.lower().replace("_", " "),
            f"default `{_text(parameter.value)}`{f' [{unit[1]}]' if unit else ''}",
            *(f"from {limit.from_value:g} to {limit.to_value:g}" for limit in descriptor.floating_point_range),
            descriptor.additional_constraints,
            "read-only" * descriptor.read_only,
        )
        yield _entry(name, details, descriptor.description.replace(unit[0], "", 1) if unit else descriptor.description)


def _text(value: Any) -> str:  # noqa: ANN401 - of any parameter
    """Return a default as in a parameter file."""
    if isinstance(value, (bool, float)):
        return f"{value:g}" if isinstance(value, float) else str(value).lower()
    return json.dumps(value if isinstance(value, (str, int)) else list(value or ()))


def _endpoints(node: AnyNode) -> Iterator[str]:
    """Yield an entry for every topic and service of the suite's own."""
    texts = _topic_texts()
    for direction, endpoints in (("published", node.publishers), ("subscribed", node.subscriptions)):
        for endpoint in endpoints:
            name = endpoint.topic_name.removeprefix(NAMESPACE)
            if name not in {"/rosout", "/parameter_events"} and "/transition_event" not in name:
                details = (direction, _type(endpoint.msg_type), *_qos(endpoint.qos_profile))
                yield _entry(name, details, texts.get(name, ""))
    for service in node.services:
        if service.srv_type.__module__.startswith("std_srvs"):
            name = service.srv_name.replace(f"{NAMESPACE}{node.get_name()}/", "~/")
            yield _entry(name, ("service", _type(service.srv_type)), "")


def _type(kind: type) -> str:
    return f"`{kind.__module__.partition('.')[0]}/{kind.__name__}`"


def _topic_texts() -> dict[str, str]:
    """Return the docstrings of the topic names in `wire.topics`."""
    body = ast.parse((ROOT / "scara_effmass/wire/topics.py").read_text(encoding="utf-8")).body
    return {
        name.value.value: " ".join(text.value.value.split())
        for name, text in pairwise(body)
        if isinstance(name, ast.Assign) and isinstance(name.value, ast.Constant)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
    }


def _qos(qos: QoSProfile) -> tuple[str, ...]:
    times = {"deadline": qos.deadline, "lifespan": qos.lifespan, "liveliness lease": qos.liveliness_lease_duration}
    seconds = {name: time.nanoseconds / 1e9 for name, time in times.items()}
    return (
        "reliable" if qos.reliability is ReliabilityPolicy.RELIABLE else "best effort",
        "transient local" * (qos.durability is DurabilityPolicy.TRANSIENT_LOCAL),
        f"depth {qos.depth}",
        *(f"{name} {s:g} s" for name, s in seconds.items() if 0 < s < FOREVER_S),
    )


def _message(path: Path) -> str:
    """Return the section of a message; a comment above a field, or several fields, describes them."""
    head, _, body = path.read_text(encoding="utf-8").partition("\n\n")
    entries, comment, used = [], [], False
    for line in body.splitlines():
        code, _, text = (part.strip() for part in line.partition("#"))
        if not code and text:
            comment, used = [] if used else comment, False
            comment.append(text)
        elif code:
            kind, name = code.split(maxsplit=1)
            entries.append(_entry(name, (f"`{kind}`",), text or " ".join(comment)))
            used = True
        elif comment and not used:
            entries.append(f"**{' '.join(comment)}**")
            comment = []
        else:
            comment, used = [], False
    text = " ".join(filter(None, (line.lstrip("# ") for line in head.splitlines())))
    return "\n\n".join((f"## {path.stem}", text, *entries))


def _command(name: str) -> str:
    """Return the section of a command; of several options in a group one is required."""
    command = COMMANDS[name]
    entries = []
    for group in command.groups:
        for option in group:
            words = option.keywords
            value = words.get("metavar") or "|".join(words.get("choices") or ()) or option.dest.upper()
            value = " ".join(value) if isinstance(value, tuple) else value
            takes_value = words.get("action") != "store_true" and option.names[0].startswith("-")
            names = ", ".join(option.names) if option.names[0].startswith("-") else value
            required = "required" if words.get("required") else f"one of these {len(group)}" * (len(group) > 1)
            entries.append(_entry(f"{names}{f' {value}' * takes_value}", (required,), words["help"]))
    text, _, examples = command.epilog.partition("examples:\n")
    examples = "\n".join(line.strip() for line in examples.splitlines())
    summary = f"{command.summary[0].upper()}{command.summary[1:]}."
    return "\n\n".join((f"## {name}", summary, text, f"```sh\n{examples}\n```", *entries))


def _diagnostics() -> Iterator[str]:
    """Yield an entry for every status: the keys in the functions of nodes that return one."""
    for path in sorted((ROOT / "scara_effmass/nodes").glob("*_*.py")):
        node = path.stem.replace("_health", "_node")
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            parts = list(ast.walk(function)) if isinstance(function, ast.FunctionDef) else []
            keys = [key for part in parts if isinstance(part, ast.Dict) for key in part.keys if key]
            keys += [part.key for part in parts if isinstance(part, ast.DictComp)]
            names = dict.fromkeys(map(_pattern, sorted(keys, key=lambda key: (key.lineno, key.col_offset))))
            for call in (part for part in parts if isinstance(part, ast.Call) and ast.unparse(part.func) == "status"):
                yield f"`{node}`: **{_pattern(call.args[0])}**: {', '.join(f'`{name}`' for name in names)}"


def _pattern(text: ast.expr) -> str:
    """Return a string of the source, … in place of what varies."""
    if isinstance(text, ast.JoinedStr):
        return "".join(map(_pattern, text.values))
    return str(text.value) if isinstance(text, ast.Constant) else "…"


def _entry(term: str, details: Iterable[str], text: str) -> str:
    """Return an entry of a list of definitions, or a line where there is no `text`."""
    line = f"`{term}`{''.join(f', {detail}' for detail in details if detail)}"
    text = re.sub(r"[<*]", r"\\\g<0>", text)
    return f"{line}\n: {text[0].upper()}{text[1:]}" if text else line


def _api(name: str) -> str:
    """Return the section of a public name: docstrings and signatures."""
    target = getattr(scara_effmass, name)
    sections = [f"## {name}", f"```python\n{_signature(target, name)}\n```", inspect.getdoc(target) or ""]
    for member in vars(target) if inspect.isclass(target) else ():
        value = inspect.getattr_static(target, member)
        value = getattr(target, member) if isinstance(value, (classmethod, staticmethod)) else value
        text = (inspect.getdoc(value) or "").replace("\n", "\n  ")
        if text and not member.startswith("_") and (callable(value) or isinstance(value, property)):
            sections.append(f"**`{_signature(value, member) if callable(value) else member}`**\n: {text}")
    return "\n\n".join(sections)


def _signature(target: Any, name: str) -> str:  # noqa: ANN401 - any callable
    """Return the call of `target`, without modules in the names of types."""
    try:
        signature = str(inspect.signature(target))
    except ValueError:
        return name
    return name + re.sub(r"(?<![\w.])(?:[A-Za-z_]\w*\.)+", "", signature).replace("self, ", "").replace("(self)", "()")


if __name__ == "__main__":
    main()
