"""A real browser: Debian's Chromium, driven through chromium-driver. Nothing is downloaded for it."""

import json
import os
import shutil
from contextlib import contextmanager

from debian import program
from selenium import webdriver
from selenium.webdriver.chrome.service import Service


@contextmanager
def browser(folder, *, width=1400, height=1400, phone=False):
    """Open a browser of its own, without a screen; it keeps what the page asked for."""
    packages = ("chromium", "chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = program("chromium", *packages)
    driver_program = program("chromedriver", *packages)
    profile = folder / "profile"
    for argument in (
        "--headless=new", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", f"--user-data-dir={profile}",
        f"--window-size={width},{height}", *(["--no-sandbox"] if os.geteuid() == 0 else []),
    ):  # fmt: skip
        options.add_argument(argument)
    if phone:
        metrics = {"width": 390, "height": 844, "pixelRatio": 2}
        options.add_experimental_option("mobileEmulation", {"deviceMetrics": metrics})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(driver_program))
    driver.set_page_load_timeout(300)
    driver.set_script_timeout(300)
    try:
        yield driver
    finally:
        driver.quit()
        shutil.rmtree(profile, ignore_errors=True)


def asked_for(driver):
    """Return the addresses of all that the page has asked for since the last call."""
    messages = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    return [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]


def complaints(driver):
    """Return what the browser complains of: scripts that failed, policies that were broken."""
    return [entry["message"] for entry in driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]
