"""Small ARXML files: messages of one CAN cluster with E2E protection."""

HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<AUTOSAR xmlns="http://autosar.org/schema/r4.0" '
    'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
    'xsi:schemaLocation="http://autosar.org/schema/r4.0 AUTOSAR_00046.xsd">'
)


def tag(name, *inside, **attributes):
    """Return an element; its name has _ for -."""
    said = "".join(f' {key}="{value}"' for key, value in attributes.items())
    name = name.replace("_", "-")
    return f"<{name}{said}>{''.join(str(each) for each in inside)}</{name}>"


def package(name, *elements):
    return tag("AR_PACKAGE", tag("SHORT_NAME", name), tag("ELEMENTS", *elements))


def reference(kind, path, name=None):
    return tag(f"{name or kind}_REF", path, DEST=kind.replace("_", "-"))


def frame(name, length, secured=False):
    kind, path = ("SECURED_I_PDU", f"/Secured/{name}") if secured else ("I_SIGNAL_I_PDU", f"/Pdu/{name}")
    mapping = tag("PDU_TO_FRAME_MAPPING", tag("SHORT_NAME", "m"), reference(kind, path, "PDU"))
    return tag("CAN_FRAME", tag("SHORT_NAME", name), tag("FRAME_LENGTH", length), tag("PDU_TO_FRAME_MAPPINGS", mapping))


def pdu(name, length, at, grouped):
    place = tag("PACKING_BYTE_ORDER", "MOST-SIGNIFICANT-BYTE-LAST") + tag("START_POSITION", at)
    signal = tag(
        "I_SIGNAL_TO_I_PDU_MAPPING", tag("SHORT_NAME", "s"), reference("I_SIGNAL", f"/Signal/{name}_Speed"), place
    )
    group = tag("I_SIGNAL_TO_I_PDU_MAPPING", tag("SHORT_NAME", "g"), reference("I_SIGNAL_GROUP", f"/Signal/{name}"))
    mapped = tag("I_SIGNAL_TO_PDU_MAPPINGS", signal, group if grouped else "")
    return tag("I_SIGNAL_I_PDU", tag("SHORT_NAME", name), tag("LENGTH", length), mapped)


def secured_pdu(name, length, data_id, freshness, truncated, mac):
    """Return a secured PDU, and the packages of its payload's triggering and its properties."""
    own = tag("SECURE_COMMUNICATION_PROPS", tag("DATA_ID", data_id))
    outer = tag(
        "SECURED_I_PDU",
        tag("SHORT_NAME", name),
        tag("LENGTH", length),
        reference("SECURE_COMMUNICATION_AUTHENTICATION_PROPS", f"/Props/{name}_a", "AUTHENTICATION_PROPS"),
        reference("SECURE_COMMUNICATION_FRESHNESS_PROPS", f"/Props/{name}_f", "FRESHNESS_PROPS"),
        reference("PDU_TRIGGERING", f"/Props/{name}_t", "PAYLOAD"),
        own,
    )
    triggering = tag(
        "PDU_TRIGGERING", tag("SHORT_NAME", f"{name}_t"), reference("I_SIGNAL_I_PDU", f"/Pdu/{name}", "I_PDU")
    )
    authentication = tag(
        "SECURE_COMMUNICATION_AUTHENTICATION_PROPS",
        tag("SHORT_NAME", f"{name}_a"),
        "" if mac is None else tag("AUTH_INFO_TX_LENGTH", mac),
    )
    fresh = tag(
        "SECURE_COMMUNICATION_FRESHNESS_PROPS",
        tag("SHORT_NAME", f"{name}_f"),
        tag("FRESHNESS_VALUE_LENGTH", freshness),
        tag("FRESHNESS_VALUE_TX_LENGTH", truncated),
    )
    return package("Secured", outer) + package("Props", triggering, authentication, fresh)


def ids(values):
    return tag("DATA_IDS", *(tag("DATA_ID", value) for value in values))


def protection(name, category, values):
    """Return a protection by the message's PDU (END-TO-END-PROTECTION-SET)."""
    of = tag("END_TO_END_PROTECTION_I_SIGNAL_I_PDU", reference("I_SIGNAL_I_PDU", f"/Pdu/{name}"))
    return tag(
        "END_TO_END_PROTECTION",
        tag("SHORT_NAME", name),
        tag("END_TO_END_PROFILE", tag("CATEGORY", category), ids(values)),
        tag("END_TO_END_PROTECTION_I_SIGNAL_I_PDUS", of),
    )


def transformed(name, values):
    """Return a signal group that a transformer of its own protects."""
    inner = tag(
        "END_TO_END_TRANSFORMATION_I_SIGNAL_PROPS_CONDITIONAL",
        reference("TRANSFORMATION_TECHNOLOGY", f"/Transformers/Set/{name}", "TRANSFORMER"),
        ids(values),
    )
    for outer in (
        "END_TO_END_TRANSFORMATION_I_SIGNAL_PROPS_VARIANTS",
        "END_TO_END_TRANSFORMATION_I_SIGNAL_PROPS",
        "TRANSFORMATION_I_SIGNAL_PROPSS",
    ):
        inner = tag(outer, inner)
    return tag("I_SIGNAL_GROUP", tag("SHORT_NAME", name), inner)


def transformer(name, profile):
    description = tag("END_TO_END_TRANSFORMATION_DESCRIPTION", tag("PROFILE_NAME", profile))
    return tag(
        "TRANSFORMATION_TECHNOLOGY",
        tag("SHORT_NAME", name),
        tag("PROTOCOL", "E2E"),
        tag("TRANSFORMATION_DESCRIPTIONS", description),
    )


def arxml(messages, secured=None):
    """Return the text of a file.

    Args:
        messages: identifier, name, length [byte], first bit of its signal Speed, name of the profile, data ids, and
            whether its signal group has a transformer, or its PDU a protection.
        secured: name -> length of the secured PDU, its data id, bits of freshness value, of what is sent of it, of MAC.
    """
    secured = secured or {}
    triggerings = [
        tag(
            "CAN_FRAME_TRIGGERING",
            tag("SHORT_NAME", f"t{name}"),
            reference("CAN_FRAME", f"/Frame/{name}", "FRAME"),
            tag("CAN_ADDRESSING_MODE", "STANDARD"),
            tag("IDENTIFIER", can_id),
        )
        for can_id, name, *_ in messages
    ]
    channel = tag("CAN_PHYSICAL_CHANNEL", tag("SHORT_NAME", "c"), tag("FRAME_TRIGGERINGS", *triggerings))
    variant = tag("CAN_CLUSTER_CONDITIONAL", tag("PHYSICAL_CHANNELS", channel))
    cluster = tag("CAN_CLUSTER", tag("SHORT_NAME", "Bus"), tag("CAN_CLUSTER_VARIANTS", variant))
    signals = [tag("I_SIGNAL", tag("SHORT_NAME", f"{name}_Speed"), tag("LENGTH", 16)) for _, name, *_ in messages]
    groups = [transformed(name, values) for _, name, _, _, _, values, by_group in messages if by_group]
    technologies = [transformer(name, profile) for _, name, _, _, profile, _, by_group in messages if by_group]
    transformers = tag(
        "DATA_TRANSFORMATION_SET", tag("SHORT_NAME", "Set"), tag("TRANSFORMATION_TECHNOLOGYS", *technologies)
    )
    protections = [
        protection(name, profile, values)
        for _, name, _, _, profile, values, by_group in messages
        if not by_group and name not in secured
    ]
    protected = tag("END_TO_END_PROTECTION_SET", tag("SHORT_NAME", "All"), tag("END_TO_END_PROTECTIONS", *protections))
    packages = (
        package("Cluster", cluster),
        package(
            "Frame",
            *(
                frame(name, *([secured[name][0], True] if name in secured else [length]))
                for _, name, length, *_ in messages
            ),
        ),
        package("Pdu", *(pdu(name, length, at, by_group) for _, name, length, at, _, _, by_group in messages)),
        package("Signal", *signals, *groups),
        package("Transformers", transformers),
        package("Protections", protected),
    )
    packages += tuple(secured_pdu(name, *what) for name, what in secured.items())
    return HEAD + tag("AR_PACKAGES", *packages) + "</AUTOSAR>\n"
