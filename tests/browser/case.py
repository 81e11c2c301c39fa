"""What tests of the page in a browser have in common."""

import os
import pathlib
import unittest

from browser import Browser, find_program

TITLE = "document.querySelector('#standing-title').textContent"
MAY_ARM = "document.querySelector('#arm').getAttribute('aria-disabled') === 'false'"
IS_LIVE = "!document.body.classList.contains('is-away')"


@unittest.skipUnless(find_program(), "no browser found: install chromium-headless-shell, or name one in TENDON_BROWSER")
class PageCase(unittest.TestCase):
    """A browser for all tests of a class."""

    #: How long a page may take to come up, s; None for what the browser's driver waits.
    up_within_s = None
    #: What the names of its screenshots begin with.
    screenshot_prefix = ""

    @classmethod
    def setUpClass(cls):
        cls.browser = cls.enterClassContext(Browser(find_program()))

    def open_page(self, address, **options):
        """The page at this address, once it is live. A script's error in it fails the test."""
        page = self.browser.open(address, **options)
        self.addCleanup(lambda: self.assertEqual(page.errors(), []))
        limit = [] if self.up_within_s is None else [self.up_within_s]
        page.wait_for(f"{IS_LIVE} && {TITLE} !== ''", *limit)
        return page

    def screenshot(self, page, name):
        """Keeps what the page shows, where TENDON_SCREENSHOTS names a folder."""
        folder = os.environ.get("TENDON_SCREENSHOTS")
        if folder:
            pathlib.Path(folder).mkdir(parents=True, exist_ok=True)
            page.save_screenshot(pathlib.Path(folder) / f"{self.screenshot_prefix}{name}.png")
