"""The page of 2000 messages, of which one ECU's hundred are missing: the cause first, and all else folded."""

import itertools
import os
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import networks
import pytest
from browser import browser, complaints
from kernel_can import wait_for
from page_address import address_of
from processes import gateway as command_line
from processes import process
from selenium.webdriver.common.by import By

from gateway.bus.frames import empty, put
from gateway.runtime.app import Gateway
from gateway_serve.status_socket import StatusSocket

pytestmark = pytest.mark.system

ECUS, MESSAGES, CYCLE_MS = 20, 100, 1000
#: Rounds of traffic until the brakes are dead, and until the page is looked at; step of the gateway [s].
DEAD_S, LOOK_S, STEP_S = 6, 12, 0.1
FIRST = 0x80001000  # extended identifiers
NETWORK = {
    "can0": {
        "Brakes" if ecu == 0 else f"Ecu{ecu}": [(FIRST + ecu * MESSAGES + k, CYCLE_MS) for k in range(MESSAGES)]
        for ecu in range(ECUS)
    }
}
MOST_NODES, MOST_PIXELS = 5000, 3000


def drive(folder, ready, ended):
    """Feed traffic at the gateway's own pace, however slow this machine is; the brakes are dead from a time on."""
    gateway = Gateway(networks.config_of(folder, NETWORK), folder / "m.sqlite")
    state = {"bus": "can0", "uri": "in this process", "state": "open"}
    page = StatusSocket(folder / "status", gateway, lambda: [state])
    gateway.listen(page.report)
    try:
        ready.set()
        feed(gateway, page, ended)
    finally:
        page.close()
        gateway.close()


def feed(gateway, page, ended):
    round_ = empty(ECUS * MESSAGES)
    for k in range(len(round_)):
        put(round_, k, round(k * CYCLE_MS * 1e6 / len(round_)), FIRST + k, bytes([k % 200] * 8))
    alive = round_[round_["can_id"] >= FIRST + MESSAGES]
    gateway.start(0)
    for turn in itertools.count():
        frames, begun_ns = (round_ if turn < DEAD_S else alive).copy(), round(turn * CYCLE_MS * 1e6)
        frames["t_ns"] += begun_ns
        for at_ns in range(begun_ns, begun_ns + round(CYCLE_MS * 1e6), round(STEP_S * 1e9)):
            until_ns = at_ns + round(STEP_S * 1e9)
            mine = frames[(frames["t_ns"] >= at_ns) & (frames["t_ns"] < until_ns)]
            gateway.feed(mine)
            gateway.advance(until_ns)
            page.on_frames(mine)
            for _ in range(10 if turn > LOOK_S else 1):
                page.turn(time.monotonic())
                if turn > LOOK_S and ended.wait(STEP_S / 10):
                    return


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    folder = tmp_path_factory.mktemp("many")
    ready, ended = threading.Event(), threading.Event()
    with ExitStack() as stack:
        driving = threading.Thread(target=drive, args=(folder, ready, ended))
        driving.start()
        stack.callback(driving.join)
        stack.callback(ended.set)
        assert ready.wait(300)
        page = stack.enter_context(process("serve", "--status", "status", "--port", "0", cwd=folder, ready="page:"))
        driver = stack.enter_context(browser(folder))
        made = SimpleNamespace(folder=folder, driver=driver, url=address_of(page.said, folder))
        made.pictures = Path(os.environ.get("GATEWAY_PICTURES", folder))
        driver.get(made.url)
        wait_for(lambda: text_of(made, "verdict-text") == "Cause: ecu can0.Brakes")
        yield made


def text_of(many, name):
    return many.driver.find_element(By.ID, name).text


def test_the_page_leads_with_the_cause_and_folds_a_hundred_symptoms(many):
    said = text_of(many, "verdict-more")
    wait_for(lambda: "100 messages of ECU Brakes: message missing" in text_of(many, "verdict-more"))
    many.driver.refresh()
    wait_for(lambda: text_of(many, "verdict-text") == "Cause: ecu can0.Brakes")
    wait_for(lambda: many.driver.find_elements(By.CSS_SELECTOR, ".fault .plot canvas, .fault .plot div"))
    time.sleep(3.0 if "GATEWAY_PICTURES" in os.environ else 0.0)
    nodes, height = many.driver.execute_script(
        "return [document.querySelectorAll('*').length, document.documentElement.scrollHeight]"
    )
    paint = many.driver.execute_script(
        "return performance.getEntriesByName('first-contentful-paint').map((e) => e.startTime)"
    )
    print(f"{nodes} nodes, {height} pixels, first paint after {paint} ms; {said}")
    many.driver.save_screenshot(str(many.pictures / "many.png"))
    assert nodes < MOST_NODES
    assert height < MOST_PIXELS
    assert len(many.driver.find_elements(By.CSS_SELECTOR, "[data-dtc]")) == 1, (
        "the others are made when they are asked for"
    )
    assert complaints(many.driver) == []


def shown(driver, selector):
    """Wait until what a user would click is there to be seen; returns it."""
    return wait_for(
        lambda: next((e for e in driver.find_elements(By.CSS_SELECTOR, selector) if e.is_displayed()), None)
    )


def test_what_is_folded_is_found(many):
    driver = many.driver
    shown(driver, "#dtcs summary").click()
    wait_for(lambda: len(driver.find_elements(By.CSS_SELECTOR, "[data-dtc]")) == 11)
    name = f"M{FIRST + 57:X}"
    shown(driver, "#find-code").send_keys(name)
    wait_for(lambda: len(driver.find_elements(By.CSS_SELECTOR, "[data-dtc]")) == 1)
    shown(driver, "#find-test").send_keys(f"{name}.timeout")
    wait_for(lambda: driver.find_elements(By.CSS_SELECTOR, f".fault[data-fault='can0.{name}.timeout']"))
    shown(driver, "#find").send_keys(f"M{FIRST + 157:X}")
    wait_for(lambda: len(driver.find_elements(By.CSS_SELECTOR, "#messages tbody tr")) == 1)
    shown(driver, "#messages button.signal").click()
    wait_for(lambda: driver.find_elements(By.CSS_SELECTOR, "#signal-plots [data-plot] .plot > *"))
    driver.save_screenshot(str(many.pictures / "many-found.png"))
    for field in ("find-code", "find-test", "find"):
        driver.execute_script(
            "const e = document.getElementById(arguments[0]); e.value = ''; e.dispatchEvent(new Event('input'))", field
        )
    wait_for(lambda: len(driver.find_elements(By.CSS_SELECTOR, "#messages tbody tr")) == 20)
    shown(driver, "#later").click()
    wait_for(lambda: text_of(many, "page-text").startswith("21 to 40 of "))
    assert complaints(driver) == []


def test_the_terminal_says_it_in_a_few_lines(many):
    for command, most in (("list", 12), ("summary", 10)):
        told = command_line("faults", command, "--memory", "m.sqlite", cwd=many.folder)
        assert "ecu can0.Brakes" in told.stdout
        assert len(told.stdout.splitlines()) < most
