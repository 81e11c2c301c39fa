"""Looks for barriers on the page with axe-core, in a real browser: in each state, at three sizes, in light and dark.

    npm pack axe-core && tar xzf axe-core-*.tgz
    accessibility.py package/axe.min.js

The session behind the page is made up, as in the tests in a browser. Prints every finding, and counts those that axe-core calls
serious or critical.
"""

import argparse
import json
import pathlib
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/browser"))

from browser import Browser, find_program  # noqa: E402
from case import IS_LIVE, TITLE  # noqa: E402
from fixture import CUE, REPORT, Session  # noqa: E402

SIZES = [(1280, 800), (1920, 1080), (820, 1180)]
REPORTED = CUE | {"phase": "done", "ask": "nothing", "may": ["redo", "go_on"], "report": REPORT}
# What the session is like, what the page then says, and what is pressed.
SCENES = {
    "ready": ({}, "Ready", None),
    "following": ({"gesture": "extension"}, "Following", None),
    "stopped": ({"state": {"permission": "stopped", "stop_reason": "ordered"}}, "The arm is stopped", None),
    "arm's error": ({"state": {"permission": "stopped", "stop_reason": "arm-fault", "fault": "arm error 31, a collision: look around"}},
                    "The arm", None),
    "electrode off": ({"state": {"unsure": True, "troubles": [{"channel": 2, "kind": "flat"}]}}, "Unsure", None),
    "next session": ({}, "Ready", "#next-open"),
    "in French": ({}, "Ready", "#languages button[data-tag=fr]"),
    "to watch only": ({"rights": "watch"}, "Ready", None),
    "not begun": ({"kind": "failed", "desk": {"failed": "the amplifier has no power"}}, "The next one", None),
    "calibration": ({"kind": "calibration"}, "Grip", None),
    "report of a calibration": ({"kind": "calibration", "desk": {"calibration": REPORTED}}, "anna", None),
}
FIND = """axe.run().then((found) => found.violations.map(({ id, impact, help, nodes }) =>
          ({ id, impact, help, where: nodes.map(({ target }) => target.join(" ")) })))"""


def look(browser, axe, scene, size, is_dark):
    """The findings of axe-core in one scene."""
    attributes, title, pressed = SCENES[scene]
    with Session() as session:
        for name, value in attributes.items():
            setattr(session, name, value)
        page = browser.open(session.address, width=size[0], height=size[1], is_dark=is_dark)
        page.wait_for(f"{IS_LIVE} && {TITLE}.startsWith({json.dumps(title)})")
        if pressed:
            page.click(pressed)
        # Colours that are on their way to others are judged where they arrive.
        page.wait_for("document.getAnimations().length === 0")
        page.value(axe)
        return page.value(FIND)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("axe", type=pathlib.Path, help="axe.min.js of axe-core")
    axe = parser.parse_args().axe.read_text() + "; true"
    if find_program() is None:
        raise SystemExit("no browser found: install chromium-headless-shell, or name one in TENDON_BROWSER")
    looks, serious = 0, 0
    with Browser(find_program()) as browser:
        for scene in SCENES:
            for size in SIZES:
                for is_dark in (False, True):
                    looks += 1
                    for finding in look(browser, axe, scene, size, is_dark):
                        serious += finding["impact"] in ("serious", "critical")
                        print(f"{scene}, {size[0]} x {size[1]}{', dark' if is_dark else ''}: {finding['impact']}: {finding['help']}: "
                              f"{', '.join(finding['where'])}", flush=True)
    print(f"{looks} looks at {len(SCENES)} states: {serious} serious findings")


if __name__ == "__main__":
    main()
