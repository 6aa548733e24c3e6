"""`hapnet devices`: the devices that can be given to --device."""

from __future__ import annotations

from typing import Any

from hapnet.commands import flags, output


def devices(json_to: flags.Json = None) -> int:
    from hapnet.devices import registry

    words = output.console(json_to)
    rows = []
    for name, (target, package) in registry.known().items():
        row = _row(name, target, package)
        rows.append(row)
        words.print(f"{name:<10} {row['about']}", markup=False)
        state = f"missing: {row['missing']}" if row["missing"] else f"found: {', '.join(row['found']) or 'none'}"
        words.print(f"{'':<10} {row['tested']}; {row['from']}; {state}", style="dim", markup=False)
    if rules := [rule for row in rows if (rule := row["udev"])]:
        words.print(
            "without these udev rules (/etc/udev/rules.d/70-hapnet.rules) only root may open some:", markup=False
        )
        for rule in rules:
            words.print(f"  {rule}", style="dim", markup=False)
    words.print("simulated arms: --device omni, or arm:FILE.urdf?tip=LINK", markup=False)
    words.print("your own: --device module:Class, or a package with the entry point hapnet.devices")
    output.write_json(rows, json_to)
    return 0


def _row(name: str, target: str, package: str) -> dict[str, Any]:
    row: dict[str, Any] = {"name": name, "about": "", "tested": "untested", "from": package, "missing": "", "found": []}
    row["udev"] = ""
    from hapnet.loading import failure, load

    try:
        made = load("device", target, "a class that can be imported")
        row["about"], row["tested"] = getattr(made, "about", ""), getattr(made, "tested", "untested")
        row["udev"] = getattr(made, "udev", "")
        row["missing"] = made.missing() if hasattr(made, "missing") else ""
        if not row["missing"] and hasattr(made, "found"):
            row["found"] = list(made.found())
    except BaseException as error:  # another package's driver may raise anything: see `loading.failure`
        row["missing"] = failure(error)
    return row
