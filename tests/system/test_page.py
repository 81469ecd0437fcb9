"""The page in a real browser, in front of a real daemon and a scenario on the loopback bus."""

import itertools
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import threading
import time
import urllib.request
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest
import shared_signal
import warm
from browser import asked_for, browser, complaints
from kernel_can import wait_for
from page_address import address_of
from processes import GATEWAY, bus, gateway, process
from selenium.webdriver.common.by import By
from testers import isotp_stack
from udsoncan.client import Client
from udsoncan.connections import PythonIsoTpConnection
from udsoncan_settings import PATIENT

from gateway.bus.base import send_all
from gateway.bus.uri import open_bus
from gateway_fdi.common.resources import shipped

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
DTC = "P0336-39"


def run_daemon(stack, folder):
    return stack.enter_context(
        process("run", folder / "gateway.toml", "--status", folder / "status", cwd=folder, ready="monitoring")
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A bus, a daemon, its page, a browser that shows it."""
    folder = tmp_path_factory.mktemp("page")
    with ExitStack() as stack:
        uri = stack.enter_context(bus(folder))
        text = (ROOT / "gateway.toml").read_text().replace("loopback:127.0.0.1:29536", uri)
        text = text.replace("timeout_ms = 500.0\n", "")  # a sender that is silent after its scenario is no news here
        # Before and after a scenario nobody tells the speed: no operation cycle then, unless it is forced.
        text += '[access]\nunprotected = ["GW_EngineSync.EngineSpeed"]\n'
        text += '[access.reset]\nwhen = [{ signal = "GW_EngineSync.EngineSpeed", max = 0.0 }]\n'
        (folder / "gateway.toml").write_text(text)
        daemons = stack.enter_context(ExitStack())
        daemon = run_daemon(daemons, folder)
        page = stack.enter_context(
            process("serve", "--status", folder / "status", "--port", "0", cwd=folder, ready="page:")
        )
        url = address_of(page.said)
        driver = stack.enter_context(browser(folder))
        made = SimpleNamespace(folder=folder, uri=uri, url=url, driver=driver, daemon=daemon, daemons=daemons)
        made.plays = 0
        made.plain, _, made.token = url.partition("#control=")
        driver.get(url)
        wait_for(lambda: text_of(made, "#link") == "monitoring")
        yield made


def text_of(site, selector):
    found = site.driver.find_elements(By.CSS_SELECTOR, selector)
    return found[0].text if found else None


def codes(site):
    return site.driver.execute_script("return [...document.querySelectorAll('[data-dtc]')].map(e => e.dataset.dtc)")


def play(site, scenario="crank_missed_tooth"):
    """Play a scenario; returns when it ended and how long after the DTC frame's time the row was there."""
    site.plays += 1
    started = warm.Popen(
        [*GATEWAY, "simulate", scenario, "--bus", site.uri],
        cwd=site.folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        wait_for(lambda: DTC in codes(site))
        seen = time.time()
        assert started.wait(300) == 0
    finally:
        if started.poll() is None:
            started.kill()
            started.wait()
    return seen


def columns(site, fault):
    """What the plot of a fault has drawn, of BokehJS itself."""
    return site.driver.execute_script(
        """
        for (const document of Bokeh.documents)
          for (const figure of document.roots())
            if (figure.name === arguments[0]) {
              const data = figure.renderers[0].data_source.data;
              return {x: [...data.x], low: [...data.low], high: [...data.high], width: [...data.width]};
            }
        return null;
        """,
        fault,
    )


def entries(site):
    return json.loads(gateway("faults", "list", "gateway.toml", "--json", cwd=site.folder).stdout)


def interventions(site):
    """What was asked of the gateway, the newest first."""
    told = json.loads(gateway("faults", "interventions", "gateway.toml", "--json", cwd=site.folder).stdout)
    return told[::-1]


def faults_of_tester(site):
    with isotp_stack(site.uri, start=False) as stack:
        connection = PythonIsoTpConnection(stack)
        with Client(connection, config=PATIENT) as client:
            found = client.get_dtc_by_status_mask(0x08).service_data.dtcs
            return {dtc.id for dtc in found}


def test_the_dtc_appears_with_its_evidence_and_the_peak_is_in_its_column(site):
    seen = play(site)
    (entry,) = [entry for entry in entries(site) if entry["dtc"] == DTC]
    print(f"row seen {seen - entry['first_ns'] / 1e9:.3f} s after the failure's time stamp")
    wait_for(lambda: columns(site, entry["fault"]) is not None)
    peak = entry["evidence"]["value"]
    wait_for(lambda: any(abs(high - peak) < 1e-6 for high in columns(site, entry["fault"])["high"]))
    drawn = columns(site, entry["fault"])
    (at,) = [k for k, high in enumerate(drawn["high"]) if abs(high - peak) < 1e-6]
    assert drawn["low"][at] < peak, "one sample of many"
    assert max(high for k, high in enumerate(drawn["high"]) if k != at) < peak / 2, "in no other column"
    row = site.driver.find_element(By.CSS_SELECTOR, f'[data-dtc="{DTC}"]')
    row.find_element(By.TAG_NAME, "button").click()
    said = row.text
    assert f"{peak:.6g}" in said
    assert "GW_EngineSync.EngineSpeed" in said, "its freeze frame"
    assert "confirmed" in said
    address = f"{site.plain}api/recording/{DTC}/1"
    wait_for(lambda: entries(site)[0]["recordings"] == 1)
    with urllib.request.urlopen(address) as answer:
        assert b"#" in answer.read(200), "a candump log"
    assert text_of(site, "#verdict-text")
    messages = text_of(site, "#messages")
    assert "CTW_PT4" in messages
    load = site.driver.find_element(By.ID, "buses").text
    assert "load" in load
    assert complaints(site.driver) == []


def test_clear_asks_first_and_the_tester_sees_the_same(site):
    if DTC not in codes(site):
        play(site)
    number = 0x033639
    assert number in faults_of_tester(site)
    site.driver.find_element(By.ID, "clear").click()
    dialog = site.driver.find_element(By.ID, "dialog")
    assert dialog.is_displayed()
    site.driver.find_element(By.ID, "dialog-no").click()
    assert not dialog.is_displayed()
    assert DTC in [entry["dtc"] for entry in entries(site)], "asked, and the answer was no"
    site.driver.find_element(By.ID, "clear").click()
    site.driver.find_element(By.ID, "dialog-yes").click()
    wait_for(lambda: not codes(site))
    wait_for(lambda: not dialog.is_displayed())
    assert "No trouble codes" in site.driver.find_element(By.ID, "dtcs").text
    assert entries(site) == []
    assert faults_of_tester(site) == set()


def test_what_is_refused_can_be_done_all_the_same_by_who_is_asked_twice(site):
    site.driver.find_element(By.ID, "cycle").click()
    dialog, yes = site.driver.find_element(By.ID, "dialog"), site.driver.find_element(By.ID, "dialog-yes")
    yes.click()
    wait_for(lambda: text_of(site, "#dialog-yes") == "New cycle all the same")
    assert "refused (0x22)" in text_of(site, "#dialog-error")
    assert interventions(site)[0]["nrc"] == 0x22
    yes.click()
    wait_for(lambda: not dialog.is_displayed())
    done = interventions(site)[0]
    assert done["outcome"] == "done"
    assert "asked twice" in done["role"]
    site.driver.find_element(By.ID, "cycle").click()
    assert text_of(site, "#dialog-yes") == "New cycle", "what was forced once is asked for again the next time"
    site.driver.find_element(By.ID, "dialog-no").click()
    assert [text for text in complaints(site.driver) if "409" not in text] == []


def test_without_the_control_token_nothing_is_cleared(site):
    body = json.dumps({}).encode()
    for token in ("", "Bearer wrong", f"Bearer {site.token[:-1]}"):
        headers = {"content-type": "application/json", **({"authorization": token} if token else {})}
        request = urllib.request.Request(f"{site.plain}api/clear", body, headers)
        with pytest.raises(urllib.error.HTTPError, match="401"):
            urllib.request.urlopen(request)


def test_pausing_and_the_keyboard(site):
    page = site.driver.find_element(By.TAG_NAME, "body")
    page.send_keys("p")
    wait_for(lambda: text_of(site, "#pause") == "Go on")
    assert "Paused" in text_of(site, "#frozen")
    page.send_keys("p")
    wait_for(lambda: text_of(site, "#pause") == "Pause")
    if DTC not in codes(site):
        play(site)
    first = site.driver.find_element(By.CSS_SELECTOR, f'[data-dtc="{DTC}"] > button')
    wait_for(first.is_displayed)
    before = first.get_attribute("aria-expanded")
    first.send_keys("\ue007")
    wait_for(lambda: first.get_attribute("aria-expanded") != before)


def test_the_picture_freezes_at_the_failure_and_a_reload_and_a_daemon_that_restarts_recover(site):
    if DTC in codes(site):
        ended = gateway("faults", "clear", "--memory", "faults.sqlite", cwd=site.folder)
        assert ended.returncode == 0, ended.stderr
        wait_for(lambda: not codes(site))
    site.driver.find_element(By.ID, "freeze").click()
    play(site)
    wait_for(lambda: f"when {DTC} failed" in text_of(site, "#frozen"))
    site.driver.refresh()
    wait_for(lambda: DTC in codes(site))
    assert text_of(site, "#link") == "monitoring"
    site.daemon.send_signal(signal.SIGKILL)
    site.daemon.wait(300)
    wait_for(lambda: text_of(site, "#link") != "monitoring")
    assert "not reached" in text_of(site, "#verdict-text")
    site.daemon = run_daemon(site.daemons, site.folder)
    wait_for(lambda: text_of(site, "#link") == "monitoring")
    assert DTC in codes(site), "the memory has kept it"


def test_a_page_that_comes_late_shows_what_was_before(site):
    """The residual of a sender that is silent by now: no tick tells it any more."""
    if DTC not in codes(site):
        play(site)
    (entry,) = [entry for entry in entries(site) if entry["dtc"] == DTC]
    site.driver.refresh()
    wait_for(lambda: text_of(site, "#link") == "monitoring")
    site.driver.execute_script(
        "const w = document.getElementById('window'); w.value = '600'; w.dispatchEvent(new Event('input'))"
    )
    wait_for(lambda: (columns(site, entry["fault"]) or {"x": []})["x"])
    drawn = columns(site, entry["fault"])
    since_s = site.driver.execute_script("return performance.now() / 1000")
    assert drawn["x"][0] < -since_s - 1.0, "older than the page"
    peak = entry["evidence"]["value"]
    assert 1 <= sum(abs(high - peak) < 1e-6 for high in drawn["high"]) <= site.plays, "each peak is in one column"
    assert all(later > earlier for earlier, later in itertools.pairwise(drawn["x"]))


@contextmanager
def sending(uri, frames):
    """Send frames, each at its time, until the end."""
    ended = threading.Event()
    sent = np.concatenate(frames)

    def send():
        begun, at = time.monotonic(), 0
        with open_bus(uri) as wire:
            while at < len(sent) and not ended.wait(0.01):
                end = int(np.searchsorted(sent["t_ns"], (time.monotonic() - begun) * 1e9))
                send_all(wire, sent[at:end])
                at = end

    sender = threading.Thread(target=send)
    sender.start()
    try:
        yield
    finally:
        ended.set()
        sender.join()


def test_a_cause_comes_first_and_its_symptoms_are_folded_below_it(site, tmp_path):
    """Speed is 40 km/h too high: three rules fail, one verdict."""
    with ExitStack() as stack:
        uri = stack.enter_context(bus(tmp_path))
        path = shared_signal.write(tmp_path, memory='symptoms = "hold"', checks=())
        path.write_text(path.read_text().replace("loopback:127.0.0.1:0", uri))
        stack.enter_context(process("run", path, "--status", tmp_path / "status", cwd=tmp_path, ready="monitoring"))
        page = stack.enter_context(
            process("serve", "--status", tmp_path / "status", "--port", "0", cwd=tmp_path, ready="page:")
        )
        driver = site.driver
        driver.get(page.said.split()[1])
        stack.enter_context(sending(uri, [shared_signal.frames(0, 3), shared_signal.frames(3, 600, Speed=40)]))
        wait_for(lambda: driver.find_element(By.ID, "verdict-text").text == "Cause: signal can0.Speed.V")
        assert "3 tests of rules: does not hold" in driver.find_element(By.ID, "verdict-more").text
        (case,) = driver.find_elements(By.CSS_SELECTOR, "#dtcs > .case.proven.failing")
        assert case.find_element(By.CSS_SELECTOR, ".cause").text.startswith(
            ("signal can0.Speed.V (9", "signal can0.Speed.V (100")
        )
        cards = case.find_elements(By.CSS_SELECTOR, ".dtc")
        assert [card.is_displayed() for card in cards] == [True, False, False]
        assert "held" not in cards[0].text
        case.find_element(By.TAG_NAME, "summary").click()
        assert all("failing, held" in card.text for card in cards[1:])
        first = [card.find_element(By.CLASS_NAME, "fault-name").text for card in cards]
        order = "return [...document.querySelectorAll('.fault')].slice(0, 3).map((e) => e.dataset.fault)"
        wait_for(lambda: driver.execute_script(order) == first)
        wait_for(lambda: "cause: signal can0.Speed.V" in driver.find_element(By.ID, "log").text)
        assert case.find_element(By.TAG_NAME, "details").get_attribute("open"), "it stays open while it goes on"
        assert complaints(driver) == []
    site.driver.get(site.url)
    wait_for(lambda: text_of(site, "#link") == "monitoring")


def test_nothing_is_asked_of_another_host_and_the_looks_are_right(site):
    """Each look is left as a picture, for people."""
    pictures = Path(os.environ.get("GATEWAY_PICTURES", site.folder))
    for theme in ("light", "dark"):
        site.driver.execute_script("localStorage.setItem('theme', arguments[0])", theme)
        site.driver.refresh()
        wait_for(lambda: text_of(site, "#link") == "monitoring")
        ground = site.driver.execute_script("return getComputedStyle(document.body).backgroundColor")
        shade = sum(int(part) for part in ground.strip("rgb()").split(",")) / 3
        assert (shade < 100) == (theme == "dark")
        time.sleep(1.0)  # for the picture only
        site.driver.save_screenshot(str(pictures / f"{theme}.png"))
    with browser(site.folder / "phone", phone=True) as phone:
        phone.get(site.plain)
        wait_for(lambda: phone.find_element(By.ID, "link").text == "monitoring")
        wide = phone.execute_script("return document.documentElement.scrollWidth")
        assert wide <= 390, "nothing sticks out"
        time.sleep(1.0)
        phone.save_screenshot(str(pictures / "phone.png"))
        urls = asked_for(phone)
    urls += asked_for(site.driver)
    assert len(urls) > 10
    hosts = {urlsplit(url).hostname for url in urls if urlsplit(url).scheme not in ("data", "blob", "chrome")}
    assert hosts == {urlsplit(site.plain).hostname}


def test_axe_finds_nothing_serious(site):
    """Of npm; it is not part of this project."""
    folder = site.folder / "axe"
    folder.mkdir()
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("no npm here: axe-core cannot be had")
    ended = subprocess.run(
        [npm, "install", "--no-save", "--no-audit", "--no-fund", "axe-core@4"],
        cwd=folder, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    script = folder / "node_modules" / "axe-core" / "axe.min.js"
    if not script.exists():
        pytest.skip(f"axe-core cannot be installed here: {ended.stderr[-200:]}")
    for theme in ("light", "dark"):
        site.driver.execute_script("localStorage.setItem('theme', arguments[0])", theme)
        site.driver.refresh()
        wait_for(lambda: text_of(site, "#link") == "monitoring")
        wait_for(lambda: site.driver.find_elements(By.CSS_SELECTOR, ".fault > button"))
        site.driver.execute_script(script.read_text())
        found = site.driver.execute_async_script(
            "const done = arguments[0];"
            "axe.run().then((r) => done(r.violations), (e) => done([{impact: 'critical', id: String(e)}]))"
        )
        for each in found:
            print(theme, each["impact"], each["id"], [node.get("html", "")[:120] for node in each.get("nodes", [])][:3])
        assert [each["id"] for each in found if each["impact"] in ("serious", "critical")] == []


def test_the_terminal_shows_the_same(site):
    told = json.loads(gateway("watch", "--status", site.folder / "status", "--json", cwd=site.folder).stdout)
    assert told["connected"]
    assert {entry["dtc"] for entry in told["dtcs"]} == set(codes(site))
    assert told["buses"][0]["state"] == "open"


def test_a_report_opens_without_a_server(site):
    ended = gateway("simulate", "crank_missed_tooth", "--bus", "inside", "--html", "report.html", cwd=site.folder)
    assert ended.returncode == 0, ended.stderr
    asked_for(site.driver)
    complaints(site.driver)
    site.driver.get((site.folder / "report.html").as_uri())
    drawn = "return [...document.querySelectorAll('.figure')].every((f) => f.childElementCount > 0)"
    wait_for(lambda: site.driver.execute_script(drawn))
    assert DTC in site.driver.page_source
    assert {urlsplit(url).scheme for url in asked_for(site.driver)} <= {"file", "data"}
    assert complaints(site.driver) == []
    site.driver.get(site.url)


def test_a_report_with_long_names_fits_a_telephone(site):
    name = "crank_of_the_engine_that_is_in_the_front_of_the_car"
    scenario = (
        (ROOT / "scenarios" / "crank" / "crank_missed_tooth.toml").read_text().replace('"gateway.toml"', '"long.toml"')
    )
    (site.folder / "long_names.toml").write_text(scenario)
    text = (site.folder / "gateway.toml").read_text().replace('name = "crank"', f'name = "{name}"')
    (site.folder / "long.toml").write_text(text.replace('"crank.missed_pulse"', f'"{name}.missed_pulse"'))
    ended = gateway("simulate", "long_names.toml", "--bus", "inside", "--html", "long.html", cwd=site.folder)
    assert ended.returncode == 0, ended.stderr
    with browser(site.folder / "phone", phone=True) as phone:
        phone.get((site.folder / "long.html").as_uri())
        drawn = "return Bokeh.documents[0].roots().map((root) => root.inner_width ?? 0)"
        wait_for(lambda: all(phone.execute_script(drawn)))
        assert f"{name}.missed_pulse" in phone.page_source
        assert phone.execute_script("return document.documentElement.scrollWidth") <= 390, "nothing sticks out"
        assert min(phone.execute_script(drawn)) > 250, "a figure has room for its curve"
        hidden = (
            "[...document.querySelectorAll('h3, p, li, .when, .figure')].filter((e) => e.scrollWidth > e.clientWidth)"
        )
        assert phone.execute_script(f"return {hidden}.map((e) => e.outerHTML)") == []
        when = "return Math.min(...[...document.querySelectorAll('.when')].map((e) => e.clientWidth))"
        assert phone.execute_script(when) > 250


def test_the_page_of_a_demo_says_that_it_has_ended(site, tmp_path):
    command = ("demo", "--serve", "--no-open", "--port", "0", "--speed", "20")
    with process(*command, cwd=tmp_path, ready="page:") as demo:
        site.driver.get(demo.said.split()[1])
        wait_for(lambda: text_of(site, "#link") == "ended")
        wait_for(lambda: "fault" in (text_of(site, "#verdict-text") or ""))
        said = text_of(site, "#verdict-more")
        site.driver.save_screenshot(str(Path(os.environ.get("GATEWAY_PICTURES", tmp_path)) / "ended.png"))
    assert said.startswith("The scenario crank_missed_tooth has ended after 8 s. Nothing is monitored any more.\n")
    assert "stored, from" in said
    wait_for(lambda: text_of(site, "#link") == "gateway not reached")
    site.driver.get(site.url)


def test_the_picture_of_the_readme_is_of_this_page(site, tmp_path):
    """A fault with its cause. The text beside the picture is what the page says: of another page it is another one."""
    belt = shipped("scenarios/linear_belt_faults.toml").read_text().partition("[[fault]]")[0]
    fault = '[[fault]]\nkind = "actuator_offset"\nplace = 1\nfrom_s = 8.0\nto_s = 600.0\nsize = 1.0\n'
    (tmp_path / "belt.toml").write_text(belt.replace("duration_s = 40.0", "duration_s = 600.0") + fault)
    picture = Path(os.environ.get("GATEWAY_PICTURES", tmp_path)) / "page.png"
    with process("demo", "belt.toml", "--serve", "--no-open", "--port", "0", cwd=tmp_path, ready="page:") as demo:
        site.driver.set_window_size(1240, 980)
        site.driver.get(demo.said.split()[1])
        wait_for(lambda: (text_of(site, "#verdict-text") or "").startswith("Cause: "))
        wait_for(lambda: len(site.driver.find_elements(By.CSS_SELECTOR, "#dtcs > .case.proven .dtc")) == 5)
        if "GATEWAY_PICTURES" in os.environ:
            time.sleep(2.0)  # for the picture only
        site.driver.save_screenshot(str(picture))
        said = [text_of(site, part) for part in ("header", "#verdict-text", "#dtcs > .case.proven .cause")]
        site.driver.set_window_size(1400, 1400)
    text = re.sub(r"[0-9.]+", "0", "\n".join(map(str, said))) + "\n"
    if "GATEWAY_PICTURES" in os.environ:
        picture.with_suffix(".txt").write_text(text)
    site.driver.get(site.url)
    wait_for(lambda: text_of(site, "#link") == "monitoring")
    again = "GATEWAY_PICTURES=docs/images pytest tests/system/test_page.py -k readme"
    assert text == (ROOT / "docs/images/page.txt").read_text(), f"the page has changed; make its picture again: {again}"


def test_a_slow_page_does_not_hold_others_up(site):
    """Somebody opens the stream and never reads."""
    host, _, port = urlsplit(site.plain).netloc.partition(":")
    with socket.create_connection((host, int(port))) as lazy:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        lazy.sendall(f"GET /api/stream HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
        site.driver.refresh()
        wait_for(lambda: text_of(site, "#link") == "monitoring")
