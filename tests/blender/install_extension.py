"""Installs a built zip into the empty profile of BLENDER_USER_RESOURCES, and enables it again and again.

    python install_extension.py ZIP

A process of its own for `test_built_extension.py`: installing must not touch the tests' own Blender. Its last line is
JSON: what was registered, and what was left after the last time.
"""

import importlib
import json
import os
import sys

import bpy


def ours() -> dict[str, list[str]]:
    """What Blender holds of the extension: handlers by list, timers cannot be listed, types and operators by name."""
    handlers = {
        name: [
            f"{one.__module__}.{one.__name__}" for one in functions if "jghand" in str(getattr(one, "__module__", ""))
        ]
        for name in dir(bpy.app.handlers)
        if isinstance(functions := getattr(bpy.app.handlers, name), list)
    }
    types = sorted(one.__name__ for one in subclasses(bpy.types.bpy_struct) if "jghand" in one.__module__)
    operators = dir(bpy.ops.jghand) if "jghand" in dir(bpy.ops) else []
    properties = [kind.__name__ for kind in (bpy.types.Object, bpy.types.Scene) if hasattr(kind, "jghand")]
    return {
        "handlers": [name for names in handlers.values() for name in names],
        "types": types,
        "operators": operators,
        "properties": properties,
    }


def subclasses(kind: type) -> set[type]:
    """Every registered class that Python code derived from one of Blender's."""
    below = {one for child in kind.__subclasses__() for one in subclasses(child)}
    return below | {child for child in kind.__subclasses__() if getattr(child, "is_registered", False)}


def main(archive: str) -> None:
    import addon_utils  # type: ignore[import-not-found]  # bpy makes it known

    if "bl_pkg" not in bpy.context.preferences.addons:
        addon_utils.enable("bl_pkg", default_set=True)
    before = ours()
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True, overwrite=True
    )
    name = "bl_ext.user_default.jghand"
    first = ours()
    for _ in range(3):
        addon_utils.disable(name)
        assert addon_utils.enable(name) is not None
    again = ours()
    protocol = importlib.import_module(f"{name}.core").protocol.__name__
    bpy.context.scene.cursor.location = (5, 0, 0)  # beside the cube
    bpy.ops.jghand.add_hand()
    bpy.ops.jghand.apply_pose(pose="fist")
    bent = bpy.context.object.pose.bones["index2"].rotation_quaternion.angle
    bpy.data.objects.remove(bpy.context.object)
    addon_utils.disable(name)
    engine_here = sorted(module for module in sys.modules if module.split(".")[0] in ("jghand_engine", "torch"))
    print("\n" + json.dumps({
        "before": before, "first": first, "again": again, "after": ours(),
        "protocol": protocol, "engine": engine_here, "bent": bent,
    }))  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # 4.5 would hang at its end if a callable were left behind
