"""The bill of materials, and the workflows that make and sign it."""

import importlib.machinery
import importlib.util
import json
import re
from pathlib import Path

import pytest
import yaml
from cyclonedx.schema import OutputFormat, SchemaVersion
from cyclonedx.validation import make_schemabased_validator
from packaging.utils import canonicalize_name

from gateway import __version__

ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def script(name):
    loader = importlib.machinery.SourceFileLoader(name, str(ROOT / "scripts" / name))
    made = importlib.util.module_from_spec(importlib.util.spec_from_loader(name, loader))
    loader.exec_module(made)
    return made


@pytest.mark.long
@pytest.mark.evidence("Releases: bill of materials")
def test_the_bill_is_cyclonedx_and_has_every_package_of_the_lock_with_its_hashes(tmp_path):
    file = tmp_path / "bill.json"
    assert script("sbom").main([str(file)]) == 0
    bill = json.loads(file.read_text())  # whole, it was validated when it was made
    for wrong in ({}, {"type": "book"}):
        some = {**bill, "components": [{**bill["components"][0], **wrong}]}
        validator = make_schemabased_validator(OutputFormat.JSON, SchemaVersion.V1_6)
        assert (validator.validate_str(json.dumps(some)) is None) == (not wrong)
    main = bill["metadata"]["component"]
    assert (main["name"], main["version"]) == ("ecu-gateway", __version__)
    locked = script("lock").entries((ROOT / "deploy" / "requirements.lock").read_text())
    listed = {canonicalize_name(each["name"]) for each in bill["components"]}
    assert listed == set(locked)
    for each in bill["components"]:
        assert each["purl"].startswith("pkg:pypi/")
        assert each["externalReferences"][0]["hashes"]
    urls = [each["url"] for part in bill["components"] for each in part["externalReferences"]]
    assert all(url.startswith("https://pypi.org/simple/") for url in urls)


@pytest.mark.evidence("Releases: actions")
@pytest.mark.parametrize("file", WORKFLOWS, ids=lambda file: file.stem)
def test_actions_are_pinned_by_commit_and_rights_are_given_where_they_are_needed(file):
    text = file.read_text()
    for line in re.findall(r"uses: (.*)", text):
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}  # v\d+\.\d+\.\d+", line), line
    workflow = yaml.safe_load(text)
    assert workflow["permissions"] == {"contents": "read"}
    for name, job in workflow["jobs"].items():
        given = set(job.get("permissions", {}))
        assert given == {"attest": {"id-token", "attestations"}, "publish": {"id-token"}}.get(name, set())


def test_what_is_published_was_tried_and_signed_before():
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text())["jobs"]
    assert {name: job.get("needs") for name, job in jobs.items()} == {
        "build": None, "try": "build", "attest": "try", "publish": "attest",
    }  # fmt: skip
    commands = [step.get("run", "") for step in jobs["build"]["steps"]]
    assert any("scripts/sbom" in command for command in commands)
    assert any("--require-hashes -r deploy/requirements.lock" in command for command in commands)
