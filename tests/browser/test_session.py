"""The page of real sessions in a real browser: the built programs, the simulated amplifier, an emulated xArm7.

`python3 -m unittest discover tests/browser` runs this and test_page.py. Without a browser or without the programs
(`cargo build --workspace --bins`) it is skipped, and says so. TENDON_PROGRAMS names the programs' folder.
"""

import json
import os
import socket
import unittest

from case import IS_LIVE, MAY_ARM, TITLE, PageCase
from programs import ROOT, Emulator, Home, find_programs, wait_until
from test_page import ANSWERED, STOP, is_shown

MODES = """
[[decision.modes]]
name = "y-z"
extension = "+z"
flexion = "-z"
ulnar = "+y"
radial = "-y"
grip = "next_mode"

[[decision.modes]]
name = "x-z"
extension = "+z"
flexion = "-z"
ulnar = "+x"
radial = "-x"
grip = "next_mode"
"""
PRESSED_MODE = "document.querySelector('#modes [aria-pressed=true]')?.textContent"
#: A loaded machine is slow.
LIMIT_S = 60.0


@unittest.skipUnless(find_programs(), "the programs are not built: cargo build --workspace --bins")
class RealSessions(PageCase):
    up_within_s = LIMIT_S
    screenshot_prefix = "real-"

    def setUp(self):
        self.home = self.enterContext(Home(find_programs()))
        self.name = f"browser-{os.getpid()}-{self._testMethodName[5:12]}"

    def run_session(self, *words, arm=None):
        (self.home.path / "modes.toml").write_text(MODES)
        settings = arm.settings() if arm else []
        return self.enterContext(self.home.tendon(
            "run", "--session", self.name, "--config", "modes.toml", "--strategy", "direct", "--model",
            ROOT / "models/cnn-six-class.onnx", *settings, *words))

    def test_a_session_is_steered_from_the_page_alone(self):
        arm = self.enterContext(Emulator(find_programs()))
        tendon = self.run_session("--keyboard", "--page", "--page-port", "0", arm=arm)
        page = self.open_page(tendon.line("page: "))
        # A real arm waits to be let go.
        page.wait_for(f"{TITLE} === 'The arm waits'", LIMIT_S)
        picture = "document.querySelector('#traces').toDataURL()"
        page.wait_for(f"{picture} !== {json.dumps(page.value(picture))}")
        page.wait_for(MAY_ARM)
        page.click("#arm")
        page.wait_for(f"{TITLE} === 'Ready · rest'", LIMIT_S)
        _, _, height = arm.state()
        page.type("e")
        page.wait_for(f"{TITLE}.startsWith('Following · extension: up')", LIMIT_S)
        wait_until("the arm to rise", lambda: arm.state()[2] > height + 3)
        self.screenshot(page, "following")
        page.press_space()
        page.wait_for(f"{STOP} === 'STOPPED' && {TITLE} === 'The arm is stopped'", LIMIT_S)
        state, speed, _ = arm.state()
        self.assertEqual((state, speed), ("Stopped", 0.0))
        self.screenshot(page, "stopped")
        page.type("n")
        page.wait_for(MAY_ARM)
        page.value("document.querySelector('#arm').focus()")
        page.press_enter()
        page.wait_for(f"{TITLE} === 'Ready · rest'", LIMIT_S)

        page.click("#modes button:last-child")
        page.wait_for(f"{PRESSED_MODE} === 'x-z'", LIMIT_S)
        page.type("u")
        page.wait_for(f"{TITLE}.startsWith('Following · ulnar: forward')", LIMIT_S)
        page.type("n")
        page.wait_for(f"{TITLE} === 'Ready · rest'", LIMIT_S)

        page.click("#record")
        page.wait_for(f"{ANSWERED} === 'Recording: done'", LIMIT_S)
        page.click("#note-text")
        page.type("loose e")
        page.press_enter()
        page.wait_for(f"{ANSWERED} === 'Note “loose e”: done'", LIMIT_S)
        page.click("#record")
        page.wait_for(f"{ANSWERED} === 'End of the recording: done'", LIMIT_S)
        recordings = list(self.home.path.glob("data/**/*.mcap"))
        self.assertEqual(len(recordings), 1)
        self.assertIn(b"loose e", recordings[0].read_bytes())
        self.assertEqual(tendon.end(), 0)
        page.wait_for(f"{TITLE} === 'The session has ended'", LIMIT_S)

    def test_the_next_session_comes_at_the_same_page(self):
        tendon = self.run_session("--keyboard", "--page", "--page-port", "0")
        page = self.open_page(tendon.line("page: "))
        page.wait_for(f"{TITLE} === 'Ready · rest' && {is_shown('#next-open')}", LIMIT_S)
        page.click("#next-open")
        page.click("[data-choice=task] [data-option=zones]")
        page.click("#next .column:first-child .begins")
        page.wait_for(f"{ANSWERED} === 'Next session: begun' && {IS_LIVE} && {TITLE} === 'The arm waits'", LIMIT_S)
        page.wait_for(MAY_ARM)
        page.click("#arm")
        page.wait_for(f"{TITLE} === 'Ready · rest' && document.querySelector('#task-zone').textContent.startsWith('Zone: ')",
                      LIMIT_S)
        self.screenshot(page, "zones")
        page.press_space()
        page.wait_for(f"{STOP} === 'STOPPED'", LIMIT_S)
        self.assertEqual(tendon.end(), 0)

    def test_a_viewer_that_reads_nothing_holds_up_neither_another_nor_the_session(self):
        tendon = self.run_session("--keyboard", "--page", "--page-port", "0")
        address = tendon.line("page: ")
        host, token = address.removeprefix("http://").split("/#")
        with socket.socket() as deaf:
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            deaf.connect((host.split(":")[0], int(host.split(":")[1])))
            deaf.sendall(f"GET /ws?token={token} HTTP/1.1\r\nHost: {host}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
                         "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode())
            self.assertTrue(deaf.recv(12).startswith(b"HTTP/1.1 101"))
            second, first = self.open_page(tendon.line("page, to watch only: ")), self.open_page(address)
            first.wait_for(f"{TITLE} === 'Ready · rest'", LIMIT_S)
            first.type("f")
            for page in (first, second):
                page.call("Page.bringToFront")
                page.wait_for(f"{TITLE}.startsWith('Following · flexion')", LIMIT_S)
            first.press_space()
            for page in (first, second):
                page.call("Page.bringToFront")
                page.wait_for(f"{TITLE} === 'The arm is stopped'", LIMIT_S)
            first.wait_for("document.querySelector('#latency-facts').textContent.includes('Restarts: 0.')", LIMIT_S)
        self.assertEqual(tendon.end(), 0)
        self.assertFalse(any("goes on without" in line for line in tendon.lines), tendon.lines)

    def test_the_page_of_a_session_that_is_started_again_comes_back(self):
        shown = self.enterContext(self.home.tendon("page", "--session", self.name, "--page-port", "0"))
        at_rest = ("--set", 'acquisition.simulate.script="rest 60s"')
        before = self.run_session(*at_rest)
        page = self.open_page(shown.line("page: "))
        page.wait_for(f"{TITLE} === 'Ready · rest'", LIMIT_S)
        self.assertEqual(before.end(), 0)
        page.wait_for(f"!({IS_LIVE})", LIMIT_S)
        self.screenshot(page, "no-session")
        self.run_session(*at_rest)
        page.wait_for(f"{IS_LIVE} && {TITLE} === 'Ready · rest'", LIMIT_S)
        page.press_space()
        page.wait_for(f"{STOP} === 'STOPPED'", LIMIT_S)

    def test_a_stranger_is_calibrated_from_the_first_cue_to_the_report_and_on_to_a_session(self):
        tendon = self.enterContext(self.home.tendon(
            "calibrate", "anna", "--set", f"session={self.name}", "--page", "--page-port", "0", "--rest", "2s", "--hold", "2s",
            "--pause", "1s", "--set", "acquisition.simulate.profile=stranger-19"))
        page = self.open_page(tendon.line("page: "))
        page.wait_for(f"{TITLE} === 'Ready? Press Go on'", LIMIT_S)
        page.press_enter()
        page.wait_for(f"{TITLE}.endsWith(': light, firm, light')", LIMIT_S)
        page.wait_for("Number(document.querySelector('#effort-made').style.transform.slice(7, -1)) > 0.2", LIMIT_S)
        self.screenshot(page, "calibration")
        page.wait_for(f"{TITLE} === 'anna is calibrated'", LIMIT_S)
        page.wait_for("/^\\d+\\u00a0%$/.test(document.querySelector('.accuracy').textContent)")
        self.screenshot(page, "calibration-report")
        page.click(".report-orders .begins")
        page.wait_for(f"{ANSWERED} === 'Session with anna: begun' && {IS_LIVE} && {TITLE} === 'The arm waits'", LIMIT_S)
        page.wait_for(MAY_ARM)
        page.click("#arm")
        page.wait_for(f"/^(Ready|Following) · /.test({TITLE})", LIMIT_S)
        page.wait_for("document.querySelector('#session-facts').textContent.includes('anna')", LIMIT_S)


if __name__ == "__main__":
    unittest.main()
