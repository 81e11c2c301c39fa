"""The page of made-up sessions in a real browser. `python3 -m unittest discover tests/browser` runs this and test_session.py;
skipped where no browser is.

TENDON_BROWSER names a browser; TENDON_SCREENSHOTS names a folder that gets a screenshot of each state.
"""

import gzip
import json
import pathlib
import re
import time
import unittest

from case import IS_LIVE, MAY_ARM, TITLE, PageCase
from fixture import CUE, JOINTS_RAD, RECORDING, REPORT, START_MM, WEB, Session

ROOT = pathlib.Path(__file__).resolve().parents[2]
MOST_BYTES = 300_000
STOP = "document.querySelector('#stop .order-name').textContent"
ANSWERED = "document.querySelector('#request-outcome').textContent"
OUTCOME = "document.querySelector('#order-outcome').textContent"
DETAIL = "document.querySelector('#standing-detail').textContent"


def is_shown(selector):
    return f"document.querySelector('{selector}').offsetParent !== null"


def kebab(name):
    return re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower()


class Texts(unittest.TestCase):
    """What needs no browser."""

    def setUp(self):
        self.texts = json.loads((WEB / "texts.json").read_text())

    def test_every_text_is_there_in_every_language_with_the_same_places(self):
        places = {language: {key: sorted(re.findall(r"\{\w+\}", text)) for key, text in texts.items()}
                  for language, texts in self.texts.items()}
        self.assertEqual(sorted(places), ["en", "fr"])
        self.assertEqual(places["en"], places["fr"])

    def test_every_text_that_the_page_asks_for_is_there(self):
        asked = set(re.findall(r'data-(?:text|label)="([^"]+)"', (WEB / "index.html").read_text()))
        for script in WEB.glob("*.js"):
            asked |= set(re.findall(r'\btext\("([\w.+-]+)"', script.read_text()))
        self.assertGreater(len(asked), 40)
        self.assertEqual(sorted(asked - set(self.texts["en"])), [])

    def test_every_reason_to_stop_has_words(self):
        source = (ROOT / "shared/messages/src/permission.rs").read_text()
        reasons = re.findall(r"^        (\w+) = \d+,", source[source.index("pub enum StopReason"):], re.MULTILINE)
        self.assertGreater(len(reasons), 20)
        self.assertEqual([reason for reason in reasons if f"reason.{kebab(reason)}" not in self.texts["en"]], [])

    def test_all_that_the_server_says_under_a_key_has_words(self):
        said = set()
        for source in ("shared/process/src", "shared/session/src", "services/page/src", "services/robot/src", "services/supervisor/src"):
            for path in (ROOT / source).rglob("*.rs"):
                said |= set(re.findall(r'with_key\("([^"]+)"\)', path.read_text()))
        self.assertGreater(len(said), 10)
        findings = set()
        for source, kind in (("shared/people/src/finding.rs", "Finding"), ("shared/guide/src/watch.rs", "Trouble")):
            text = (ROOT / source).read_text()
            variants = text[text.index(f"pub enum {kind} {{"):].split("\n}\n")[0]
            findings |= {kebab(name).replace("-", "_") for name in re.findall(r"^    ([A-Z]\w+)[ ,]", variants, re.MULTILINE)}
        self.assertGreater(len(findings), 8)
        keys = {f"said.{key}" for key in said} | {f"finding.{kind}" for kind in findings}
        self.assertEqual(sorted(keys - set(self.texts["en"])), [])

    def test_the_page_is_small(self):
        self.assertLess(sum(len(gzip.compress(path.read_bytes())) for path in WEB.iterdir()), MOST_BYTES)


class InBrowser(PageCase):
    def setUp(self):
        self.session = self.enterContext(Session())

    def open(self, **options):
        return self.open_page(self.session.address, **options)

    def test_traces_move_and_a_gesture_shows(self):
        page = self.open()
        page.wait_for(f"{TITLE} === 'Ready · rest'")
        picture = "document.querySelector('#traces').toDataURL()"
        page.wait_for(f"{picture} !== {json.dumps(page.value(picture))}")
        self.session.gesture = "extension"
        page.wait_for(f"{TITLE} === 'Following · extension: up · 0.93'")
        page.wait_for("document.querySelector('#hand use').getAttribute('href') === '#hand-extension'"
                      " && document.querySelector('#hand use').getBBox().width > 50")
        page.wait_for("/^p50 \\d/.test(document.querySelector('#muscle-to-pixel').textContent)")
        page.wait_for("document.querySelectorAll('#hops tr').length === 4")
        self.screenshot(page, "following")

    def test_the_arm_is_drawn_where_it_is(self):
        page = self.open()
        joints = json.dumps(self.session.hello()["arm"]["joints"])
        tips = [page.value(f"import('/arm.js').then((arm) => arm.forwardKinematics({joints}, {angles}).flange.slice(9))")
                for angles in ([0] * 7, JOINTS_RAD)]
        # With all joints zero the vendor's flange is there; the other is the start position in tendon-arm's tests.
        for tip, expected in zip(tips, ([206.0, 0.0, 120.5], START_MM)):
            for value, right in zip(tip, expected):
                self.assertAlmostEqual(value, right, delta=0.5)
        page.wait_for("document.querySelector('#arm-facts').textContent.startsWith('x 386 · y 0 · z 362')")

    def test_stop_is_asked_at_the_click_and_confirmed_by_the_state_alone(self):
        self.session.obeys = False
        page = self.open()
        page.click("#stop")
        page.wait_for(f"{STOP} === 'STOP asked …'")
        self.assertNotIn("stopped", page.text("#standing-title"))
        page.wait_for(f"{OUTCOME}.includes('has not confirmed')")
        self.screenshot(page, "not-confirmed")
        # It was obeyed after all.
        self.session.state = {"permission": "stopped", "stop_reason": "ordered"}
        page.wait_for(f"{STOP} === 'STOPPED' && {OUTCOME} === 'The arm has stopped.'")
        self.session.obeys, self.session.state = True, {}
        page.wait_for(f"{STOP} === 'STOP'")
        page.click("#stop")
        page.wait_for(f"{STOP} === 'STOPPED' && {TITLE} === 'The arm is stopped'")
        self.assertEqual(self.session.orders, ["stop", "stop"])
        self.screenshot(page, "stopped")
        page.wait_for(MAY_ARM)
        page.click("#arm")
        page.wait_for(f"{STOP} === 'STOP' && {TITLE} === 'Ready · rest'")
        self.assertEqual(self.session.orders[2:], ["arm"])
        # What was said of the arm is taken back when it is not so any more.
        page.wait_for(f"{OUTCOME} === 'The arm may move. Relax first.'")
        self.session.state = {"permission": "stopped", "stop_reason": "arm-fault", "fault": "arm error 31, a collision: look around"}
        page.wait_for("document.querySelector('#order-outcome').hidden"
                      f" && {DETAIL}.includes('It says: arm error 31, a collision: look around.')")
        # An arm that goes to its start position first has obeyed, too.
        self.session.obeys = False
        page.wait_for(MAY_ARM)
        page.click("#arm")
        self.session.state = {"permission": "stopped", "phase": "going-to-start"}
        page.wait_for(f"{OUTCOME}.startsWith('Armed. The arm goes to its start position first.')")

    def test_the_space_bar_stops_whatever_has_the_focus_and_enter_arms(self):
        page = self.open()
        for focus in ("#stop", "#languages button", "#arm-canvas"):
            page.value(f"document.querySelector('{focus}').focus()")
            page.press_space()
            page.wait_for(f"{STOP} === 'STOPPED'")
            # The space bar on the button that arms stops, too.
            page.value("document.querySelector('#arm').focus()")
            page.press_space()
            page.wait_for(MAY_ARM)
            page.press_enter()
            page.wait_for(f"{STOP} === 'STOP'")
        self.assertEqual(self.session.orders, ["stop", "stop", "arm"] * 3)

    def test_without_a_connection_nothing_is_shown_as_live_and_no_order_waits(self):
        page = self.open()
        # A slow screen: what came last is still to be drawn when the connection breaks.
        page.value("window.drawnSince = 0; window.requestAnimationFrame = (draw) =>"
                   " setTimeout(() => { draw(); window.drawnSince += document.body.matches('.is-away'); }, 400)")
        page.wait_for("new Promise((done) => setTimeout(() => done(true), 500))")
        self.session.accepts = False
        self.session.drop()
        page.wait_for(f"!({IS_LIVE}) && document.querySelector('#signals').inert && window.drawnSince > 0")
        page.press_space()
        page.wait_for(f"{OUTCOME}.includes('was not sent')")
        self.assertIn(page.text("#standing-title"), ("No connection to the session", "Too many pages are open"))
        self.screenshot(page, "no-connection")
        self.session.accepts = True
        page.wait_for(f"{IS_LIVE} && {TITLE} === 'Ready · rest' && !document.querySelector('#signals').inert")
        self.assertEqual(self.session.orders, [])

    def test_a_silent_session_is_told_and_still_gets_stop(self):
        page = self.open()
        self.session.is_silent = True
        page.wait_for(f"{TITLE} === 'The session is silent'")
        page.press_space()
        page.wait_for(f"{OUTCOME}.includes('has not confirmed')")
        self.assertEqual(self.session.orders, ["stop"])
        self.session.is_silent = False
        page.wait_for(f"{TITLE} === 'The arm is stopped'")

    def test_a_page_that_only_watches_gives_no_orders_and_says_so(self):
        self.session.rights = "watch"
        page = self.open()
        page.wait_for("document.querySelector('#stop .order-note').textContent.includes('only watches')")
        page.click("#stop")
        page.press_space()
        page.wait_for(f"{OUTCOME}.includes('only watches')")
        self.assertEqual(self.session.orders, [])

    def test_an_address_with_another_token_is_told_what_is_wrong(self):
        page = self.browser.open(self.session.address.split("#")[0] + "#another")
        page.wait_for(f"{TITLE} === 'This address is not valid any more'")
        bare = self.browser.open(self.session.address.split("#")[0])
        bare.wait_for(f"{TITLE} === 'The address is not complete'")

    def test_why_the_arm_does_not_follow_is_in_words(self):
        page = self.open(width=1024, height=768, is_dark=True)
        cases = [
            ({"permission": "await-rest", "calibration_left_ms": 3200}, "Relax: measuring rest, 4\u00a0s left"),
            ({"permission": "await-rest", "stop_reason": "no-commands"}, "Relax to go on"),
            ({"permission": "stopped", "phase": "going-to-start"}, "The arm moves to its start position"),
            ({"permission": "stopped", "phase": "waiting", "stop_reason": "moved-since"}, "The arm waits"),
            ({"hindrance": "at the workspace limit +z"}, "Held up · rest"),
            ({"voted": "grip", "moves": False}, "grip: gripper"),
            ({"voted": "extension", "moves": False}, "extension: the arm holds still"),
            ({"permission": "stopped", "arm_is_silent": True}, "The arm does not report"),
            ({"permission": "await-rest", "troubles": [{"channel": 1, "kind": "hum"}]}, "Relax to begin"),
            ({"unsure": True, "troubles": [{"channel": channel, "kind": "flat"} for channel in (2, 3, 5, 7)]},
             "Unsure: the arm holds still"),
        ]
        details = {}
        for number, (state, title) in enumerate(cases):
            self.session.state = state
            page.wait_for(f"{TITLE} === {json.dumps(title)}")
            details[title] = page.text("#standing-detail")
            self.screenshot(page, f"why-{number}")
            if state.get("arm_is_silent"):
                self.assertEqual(page.value(STOP), "STOP")
        page.wait_for("document.querySelector('#electrodes').textContent.startsWith('Channel 2 is flat')")
        self.assertTrue(details["Relax to begin"].startswith("Channel 1 shows only mains hum. "), details)
        self.assertEqual(details["Unsure: the arm holds still"],
                         "Channel 2 is flat · Channel 3 is flat · Channel 5 is flat · 1 more channel. Check electrodes and cables.")

    def test_a_recording_is_on_when_the_desk_says_so(self):
        self.session.obeys = False
        page = self.open()
        name = "document.querySelector('#record-name').textContent"
        page.wait_for(f"{name} === '● Record'")
        page.click("#record")
        page.wait_for(f"{name} === 'Asked …'")
        self.session.desk = {"recording": RECORDING}
        page.wait_for(f"{name} === '■ Stop recording' && {ANSWERED} === 'Recording: done'")
        page.wait_for("document.querySelector('#record-facts').textContent.startsWith('2026-05-04T10-20-30 · 0:00:0')")
        self.session.answer = {"ok": False, "text": "the disk is full"}
        page.click("#record")
        page.wait_for(f"{ANSWERED} === 'End of the recording: not done. the disk is full' && {name} === '■ Stop recording'")
        self.assertEqual(self.session.requests, [{"record": True}, {"record": False}])
        self.session.answer = {"ok": True, "text": "done"}
        self.session.desk = {"recording": None, "recording_failure": "no space left"}
        page.wait_for("document.querySelector('#no-recording').textContent.startsWith('Nothing is being recorded: no space left.')"
                      f" && {name} === '● Record'")
        self.screenshot(page, "no-recording")
        page.click("#record")
        page.wait_for(f"{name} === 'Asked …'")
        self.session.desk = {"recording_failure": "the recorder ended"}
        page.wait_for(f"{ANSWERED} === 'Recording: not done. the recorder ended'")
        # Nobody tells how the session stands any more.
        self.session.desk = None
        page.wait_for(f"!({is_shown('#actions')})")

    def test_a_note_takes_spaces_and_stop_stays_near(self):
        self.session.desk = {"recording": RECORDING}
        page = self.open()
        page.wait_for("document.querySelector('#marker').getAttribute('aria-disabled') === 'false'")
        page.click("#note-text")
        page.wait_for("document.querySelector('#stop .order-note').textContent.startsWith('Space bar twice')")
        page.type("loose e")
        page.press_enter()
        page.wait_for(f"{ANSWERED} === 'Note “loose e”: done' && document.querySelector('#note-text').value === ''")
        # A letter that makes a gesture elsewhere was typed, and nothing stopped.
        self.assertEqual((self.session.requests, self.session.orders), ([{"note": "loose e"}], []))
        page.type("so  ")
        page.wait_for(f"{STOP} === 'STOPPED' && document.activeElement !== document.querySelector('#note-text')")
        self.assertEqual(page.value("document.querySelector('#note-text').value"), "so ")
        self.session.state = {}
        page.click("#note-text")
        page.press("Escape", "Escape", 27)
        page.press_space()
        page.wait_for(f"{STOP} === 'STOPPED'")
        page.value("document.querySelector('#note-text').value = ''")
        page.click("#note-text")
        page.press_space()
        page.click("#marker")
        page.wait_for(f"{ANSWERED} === 'Note “Marker”: done'")
        self.assertEqual((self.session.requests[1:], self.session.orders), ([{"note": "Marker"}], ["stop"] * 3))

    def test_gestures_by_key_and_by_button_and_modes(self):
        page = self.open()
        page.wait_for(is_shown("#make"))
        page.type("e")
        page.wait_for(f"{TITLE} === 'Following · extension: up · 0.93'"
                      " && document.querySelector('[data-gesture=extension]').getAttribute('aria-pressed') === 'true'")
        page.click("[data-gesture=radial]")
        page.wait_for(f"{TITLE} === 'Following · radial: right · 0.93'")
        page.press("3", "Digit3", 51, "3")
        page.wait_for(f"{TITLE} === 'Following · ulnar: left · 0.93'")
        page.click("#modes button:last-child")
        page.wait_for(f"{TITLE} === 'Following · ulnar: forward · 0.93'"
                      " && document.querySelector('#modes [aria-pressed=true]').textContent === 'x-z'")
        made = [{"gesture": {"gesture": gesture, "effort": 1}} for gesture in ("extension", "radial", "ulnar")]
        self.assertEqual(self.session.requests, made + [{"mode": "x-z"}])
        self.session.answer = {"ok": False, "text": "the source follows no keys"}
        page.type("g")
        page.wait_for(f"{ANSWERED} === 'grip: not done. the source follows no keys'"
                      " && document.querySelector('[data-gesture=ulnar]').getAttribute('aria-pressed') === 'true'")

    def test_what_comes_next_is_chosen_and_the_page_comes_back(self):
        page = self.open()
        page.wait_for(is_shown("#next-open"))
        page.click("#next-open")
        page.wait_for("document.activeElement.id === 'next'")
        self.screenshot(page, "next")
        page.press_space()
        page.wait_for(f"{STOP} === 'STOPPED'")
        page.click("[data-choice=person] [data-option=anna]")
        page.wait_for("document.querySelector('[data-choice=strategy] [aria-pressed=true]').dataset.option === 'personal'")
        page.click("[data-choice=task] [data-option=zones]")
        page.click("#next .column:first-child .begins")
        page.wait_for(f"{ANSWERED} === 'Session with anna: asked …'")
        self.session.accepts = False
        self.session.drop()
        page.wait_for(f"{TITLE} === 'The next one begins'")
        self.session.accepts = True
        self.session.restart()
        page.wait_for(f"{IS_LIVE} && {ANSWERED} === 'Session with anna: begun' && document.querySelector('#next').hidden")
        page.wait_for(is_shown("#next-open"))
        page.click("#next-open")
        page.value("document.querySelector('#calibrate-name').focus()")
        page.type("n?")
        page.press_enter()
        page.wait_for("document.querySelector('#calibrate-wrong').textContent.startsWith('Take 1 to 40')")
        page.value("document.querySelector('#calibrate-name').value = ''")
        page.type("bert")
        page.click("[data-choice=how] [data-option=replace]")
        page.press("Escape", "Escape", 27)
        page.wait_for("document.activeElement.id === 'next-open'")
        self.session.answer = {"ok": False, "text": "the session has a duration"}
        page.press_enter()
        page.value("document.querySelector('#calibrate-name').focus()")
        page.type("bert")
        page.press_enter()
        page.wait_for(f"{ANSWERED} === 'Calibration of bert: not done. the session has a duration'")
        self.assertFalse(page.value(is_shown("[data-choice=repetitions]")))
        calibrate = {"gestures": None, "repetitions": None, "check": True, "redo": None, "update": True, "replace": False,
                     "name": "bert"}
        self.assertEqual(self.session.requests, [
            {"next": {"session": {"person": "anna", "strategy": "personal", "task": "zones"}}},
            {"next": {"calibrate": calibrate}}])

    def test_what_could_not_begin_is_said_with_its_reason_and_something_else_begins_from_there(self):
        page = self.open()
        page.wait_for(is_shown("#next-open"))
        begin = "#next .column:first-child .begins"
        page.click("#next-open")
        page.click(begin)
        page.wait_for(f"{ANSWERED} === 'Next session: asked …'")
        self.session.restart("failed")
        self.session.desk = {"failed": "the amplifier has no power"}
        page.wait_for(f"{IS_LIVE} && {TITLE} === 'The next one could not begin'"
                      f" && {ANSWERED} === 'Next session: could not begin' && {DETAIL} === 'the amplifier has no power'")
        self.screenshot(page, "could-not-begin")
        page.click("#next-open")
        page.click(begin)
        self.session.restart()
        page.wait_for(f"{IS_LIVE} && {TITLE} === 'Ready · rest' && {ANSWERED} === 'Next session: begun'")

    def test_a_calibration_from_its_first_cue_to_its_report(self):
        page = self.open(width=1024, height=768)
        self.session.restart("calibration")
        steps = [
            ({"ask": "wait", "may": ["go-on", "stop"]}, "Ready? Press Go on"),
            ({"ask": "relax", "gesture": "extension", "countdown_s": 3}, "Extension in 3"),
            ({}, "Grip: light, firm, light"),
            ({"ask": "wait", "trouble": {"kind": "flat", "channel": 2, "name": "2", "text": "channel 2 is flat"}, "may": ["go-on", "redo", "stop"]}, "Something is wrong"),
            ({"phase": "fitting", "ask": "nothing", "may": []}, "Learning from the recordings"),
        ]
        for number, (change, title) in enumerate(steps):
            self.session.desk = {"calibration": CUE | change}
            page.wait_for(f"{IS_LIVE} && {TITLE} === {json.dumps(title)}")
            self.screenshot(page, f"calibration-{number}")
            page.press_enter()
            page.press("r", "KeyR", 82, "r")
            page.wait_for("document.querySelector('#stop').offsetParent === null")
        # What may not be done now is not asked for.
        asked = [request["calibration"] for request in self.session.requests]
        self.assertEqual(asked, ["go-on", "redo", "redo", "go-on", "redo"])
        done = {"phase": "done", "ask": "nothing", "may": [], "report": REPORT}
        self.session.desk = {"calibration": CUE | done}
        # What the check round has shown counts before what is expected.
        page.wait_for("document.querySelector('.accuracy')?.textContent === '99\u00a0%'"
                      " && document.querySelectorAll('.confusion .is-wrong').length === 1")
        lines = page.value("[...document.querySelectorAll('.checked')].map((line) => line.textContent)")
        self.assertEqual(lines, ["71\u00a0% of it without this calibration.", "Estimate for later repetitions: 97\u00a0%."])
        self.screenshot(page, "calibration-report")
        page.value("document.querySelector('[aria-label=\"Record grip again\"]').click()")
        page.click(".report-orders .begins")
        page.wait_for(f"{ANSWERED} === 'Session with anna: asked …'")
        redo, session = (request["next"] for request in self.session.requests[len(asked):])
        self.assertEqual((redo["calibrate"]["redo"], session["session"]["person"]), ("grip", "anna"))
        self.session.restart()
        page.wait_for(f"{IS_LIVE} && {TITLE} === 'Ready · rest' && document.querySelector('#stop').offsetParent !== null")
        self.assertEqual(self.session.orders, [])

    def test_a_stopped_calibration_says_what_is_kept_and_leads_back(self):
        self.session.kind = "calibration"
        self.session.desk = {"calibration": CUE | {"ask": "wait", "may": ["go-on", "stop"]}}
        page = self.open()
        page.wait_for(f"{TITLE} === 'Ready? Press Go on'")
        page.click("#languages [lang=en]")
        page.press_enter()
        self.session.desk = {"calibration": CUE | {"phase": "stopped", "ask": "nothing", "may": []}}
        page.wait_for(f"{TITLE} === 'The calibration was stopped'"
                      f" && {DETAIL} === 'What was recorded is kept. anna stays as calibrated before.'"
                      " && document.querySelectorAll('.report-orders button').length === 3")
        page.click(".report-orders button:last-child")
        page.wait_for(is_shown("#next"))
        page.press("Escape", "Escape", 27)
        page.click(".report-orders button:nth-child(2)")
        page.wait_for(f"{ANSWERED} === 'Session as before: asked …'")
        self.assertEqual(self.session.requests, [{"calibration": "go-on"}, {"next": "back"}])

    def test_at_twice_the_size_nothing_covers_what_has_the_focus(self):
        page = self.open(width=640, height=400)
        page.wait_for(is_shown("#next-open"))
        covered, reached = [], ""
        for _ in range(40):
            page.press("Tab", "Tab", 9)
            reached, is_seen = page.value(
                "(() => { const focused = document.activeElement; const box = focused.getBoundingClientRect();"
                " const top = document.elementFromPoint(box.x + box.width / 2, Math.max(box.y, 0) + 4);"
                " return [focused.id || focused.parentElement.id, focused.contains(top)]; })()")
            if not is_seen:
                covered.append(reached)
            if reached == "languages":
                break
        self.assertEqual((reached, covered), ("languages", []))
        self.assertTrue(page.value("(() => { const box = document.querySelector('#stop').getBoundingClientRect();"
                                   " return box.y >= 0 && box.y < 30; })()"), "STOP stays at the top")

    def test_the_way_to_the_zone_is_in_words_and_drawn(self):
        zone = {"center_mm": [386, 40, 342], "width_mm": 30}
        task = {"kind": "zones", "zone": zone, "reached": 3, "trials": 4, "overshoots": 1,
                "throughput_bits_per_s": 0.912, "dwell_share": 0.0}
        self.session.desk = {"task": task}
        page = self.open()
        page.wait_for("document.querySelector('#task-zone').textContent === 'Zone: 40\u00a0mm left · 20\u00a0mm down'"
                      " && document.querySelector('#task-scores').textContent"
                      " === '3 of 4 reached · overshoots: 1 · 0.91\u00a0bit/s'")
        picture = page.value("document.querySelector('#arm-canvas').toDataURL()")
        self.session.desk = {"task": task | {"zone": zone | {"center_mm": START_MM}, "dwell_share": 0.4}}
        page.wait_for("document.querySelector('#task-zone').textContent === 'In the zone: hold still'"
                      " && document.querySelector('#task-dwell').style.transform === 'scaleX(0.4)'")
        page.wait_for(f"document.querySelector('#arm-canvas').toDataURL() !== {json.dumps(picture)}")
        self.screenshot(page, "zone")

    def test_whoever_only_watches_sees_no_actions(self):
        self.session.rights = "watch"
        self.session.desk = {"recording": RECORDING}
        page = self.open()
        page.wait_for("document.querySelector('#session .is-recording') !== null")
        for part in ("#actions", "#make", "#modes", "#next"):
            self.assertFalse(page.value(is_shown(part)), part)
        page.type("e")
        self.session.gesture = "grip"
        page.wait_for(f"{TITLE}.startsWith('grip: gripper')")
        self.assertEqual(self.session.requests, [])

    def test_everything_is_reached_by_keyboard_and_the_focus_stays(self):
        self.session.desk = {"recording": RECORDING}
        page = self.open()
        page.wait_for(is_shown("#next-open"))
        reached = []
        while len(reached) < 60 and "languages" not in reached:
            page.press("Tab", "Tab", 9)
            reached.append(page.value("document.activeElement.id || document.activeElement.parentElement.id"))
        for part in ("arm", "stop", "record", "marker", "note-text", "note-add", "next-open", "modes", "make-gestures",
                     "arm-canvas", "languages"):
            self.assertIn(part, reached)
        # States and desks that come do not take the focus away.
        self.session.gesture, self.session.desk = "flexion", {}
        page.wait_for(f"{TITLE}.startsWith('Following · flexion')")
        page.wait_for("document.querySelector('#record-name').textContent === '● Record'")
        self.assertEqual(page.value("document.activeElement.parentElement.id"), "languages")

    def test_a_tab_that_was_not_seen_catches_up_without_a_burst(self):
        page = self.open()
        page.wait_for("/^p50 \\d/.test(document.querySelector('#muscle-to-pixel').textContent)")
        page.value("window.drawn = 0; (() => { const draw = CanvasRenderingContext2D.prototype.clearRect;"
                   " CanvasRenderingContext2D.prototype.clearRect = function (...box) {"
                   " if (this.canvas.id === 'traces') window.drawn += 1; return draw.apply(this, box); }; })()")
        # As browsers do it, and chromium-headless-shell does not: a tab that nobody sees gets no frames of the screen.
        page.value("(() => { window.asked = []; window.seen = window.requestAnimationFrame;"
                   " window.requestAnimationFrame = (draw) => window.asked.push(draw);"
                   " Object.defineProperty(document, 'hidden', { get: () => true, configurable: true });"
                   " document.dispatchEvent(new Event('visibilitychange')); })()")
        self.session.gesture = "flexion"
        time.sleep(1.0)
        self.assertFalse(page.text("#standing-title").startswith("Following"))
        self.assertLessEqual(page.value("window.asked.length"), 1)
        page.value("window.drawn = 0")
        began = time.monotonic()
        page.value("(() => { window.requestAnimationFrame = window.seen; delete document.hidden;"
                   " document.dispatchEvent(new Event('visibilitychange'));"
                   " for (const draw of window.asked) window.requestAnimationFrame(draw); })()")
        page.wait_for(f"{TITLE}.startsWith('Following · flexion')")
        # 60 frames of the screen a second, and some air.
        self.assertLess(page.value("window.drawn"), 10 + 100 * (time.monotonic() - began))

    def test_two_tabs_see_the_same_and_either_stops(self):
        first, second = self.open(), self.open(width=1920, height=1080)
        first.click("#stop")
        for page in (first, second):
            page.call("Page.bringToFront")
            page.wait_for(f"{STOP} === 'STOPPED'")

    def test_the_page_speaks_french(self):
        page = self.open()
        page.click("#languages [lang=fr]")
        page.wait_for(f"{TITLE} === 'Prêt · repos' && {STOP} === 'ARRÊT' && document.documentElement.lang === 'fr'")
        # What the server says in English, too; where there is no text for it, its English.
        for key, words in [("recording-finishing", "L’enregistrement se termine. Réessayez dans un instant."),
                           ("of-a-later-version", "not now")]:
            self.session.answer = {"ok": False, "text": "not now", "key": key}
            page.click("#record")
            said = json.dumps(f"Enregistrement\u00a0: pas fait. {words}")
            page.wait_for(f"{ANSWERED} === {said}")
        self.session.restart("calibration")
        trouble = REPORT["findings"][0] | {"percent": 12.4}
        self.session.desk = {"calibration": CUE | {"trouble": trouble}}
        page.wait_for("document.querySelector('#standing-detail').textContent.startsWith("
                      "'«\u00a0ulnaire\u00a0» et «\u00a0radial\u00a0» se ressemblent 12\u00a0% du temps')")
        page.value("localStorage.clear()")


if __name__ == "__main__":
    unittest.main()
