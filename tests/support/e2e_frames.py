"""Frames protected by programs that nobody here wrote: autosar-e2e's profiles, opendbc's rules."""

import random
from types import SimpleNamespace

import e2e

from gateway.signals.protection.e2e import E2eCheck

#: Profile -> what makes a frame, bytes of the header, bits of the data id.
E2E = {
    "P01": (e2e.p01.e2e_p01_protect, 2, 16),
    "P02": (e2e.p02.e2e_p02_protect, 2, 0),
    "P04": (e2e.p04.e2e_p04_protect, 12, 32),
    "P05": (e2e.p05.e2e_p05_protect, 3, 16),
    "P06": (e2e.p06.e2e_p06_protect, 5, 16),
    "P07": (e2e.p07.e2e_p07_protect, 20, 32),
    "P11": (e2e.p11.e2e_p11_protect, 2, 16),
}
MODES = {"both": "BOTH", "alternating": "ALT", "low": "LOW", "nibble": "NIBBLE"}
CASES = [
    (profile, mode) for profile in E2E for mode in {"P01": MODES, "P11": ("both", "nibble")}.get(profile, ("both",))
]


def protection_of(check, length):
    """Return the protection of a message of this length."""
    return check.protection(SimpleNamespace(length=length))


def drawn(profile, mode, seed):
    """Return a random check, the length of its message, and what makes a frame for it as autosar-e2e does."""
    rng = random.Random(f"{profile} {mode} {seed}")
    make, header, bits = E2E[profile]
    length = rng.choice([n for n in (2, 4, 8, 12, 16, 24, 32, 64) if n > header])
    offset = 0 if profile == "P02" else rng.randint(0, length - header)
    if profile == "P02":
        ids = bytes(rng.randbytes(16))
        return (
            E2eCheck(profile=profile, data_ids=list(ids)),
            length,
            lambda data: make(data, ids, increment_counter=True),
        )
    data_id = rng.getrandbits(bits)
    options = {"offset": offset, "increment_counter": True}
    if profile in ("P01", "P11"):
        if mode == "nibble":
            data_id &= 0xFFF
        options["data_id_mode"] = getattr(getattr(e2e, profile.lower()), f"E2E_{profile}_DATAID_{MODES[mode]}")
    check = E2eCheck(profile=profile, data_id=data_id, data_id_mode=mode, offset=offset)
    return check, length, lambda data: make(data, data_id, **options)


#: Rule -> a database of opendbc that has it.
DATABASES = {
    "body": "comma_body", "chrysler": "chrysler_pacifica_2017_hybrid_generated", "fca_giorgio": "fca_giorgio",
    "honda": "honda_civic_touring_2016_can_generated", "hyundai_canfd": "hyundai_canfd_generated",
    "psa": "psa_aee2010_r3", "subaru": "subaru_global_2017_generated", "tesla": "tesla_model3_party",
    "toyota": "toyota_new_mc_pt_generated", "volkswagen_mlb": "vw_mlb", "volkswagen_mqb": "vw_mqb",
    "volkswagen_pq": "vw_pq",
}  # fmt: skip
