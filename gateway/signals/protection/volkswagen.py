"""Data ids of single messages of Volkswagen's MQB, MEB and MLB, as opendbc 0.3.1 lists them (MIT licence)."""

from __future__ import annotations

#: Identifier -> the list of 16 data ids that go in after the payload by the counter.
MQB_DATA_IDS: dict[int, bytes] = {
    0x40: bytes([0x40] * 16),
    0x86: bytes([0x86] * 16),
    0x9F: bytes([0xF5] * 16),
    0xAD: bytes.fromhex("3F6939DC94F91464D86A34CEA255B52C"),
    0xDB: bytes.fromhex("09FACA8E62D5D1F031A0AFDA4D1A0A97"),
    0xFC: bytes.fromhex("775CA0894B7CBBD61F6C4FF6202B43DD"),
    0xFD: bytes.fromhex("B4EFF8491EE5C2C097193CC9F198D661"),
    0x101: bytes([0xAA] * 16),
    0x102: bytes.fromhex("D712857E0B34FA167A252D8F048E5D35"),
    0x106: bytes([0x07] * 16),
    0x10B: bytes.fromhex("775CA0894B7CBBD61F6C4FF6202B43DD"),
    0x116: bytes([0xAC] * 16),
    0x117: bytes([0x16] * 16),
    0x120: bytes.fromhex("C4E24FE4F82F56819FE58344053F97DF"),
    0x121: bytes.fromhex("E965AE6B7B35E55F4EC786A2BBDDEBB4"),
    0x122: bytes.fromhex("377DF3A918466D4D3D71929CE53210B9"),
    0x126: bytes([0xDA] * 16),
    0x12B: bytes.fromhex("6A38B42722EFE1BBF8808449C79E1E2B"),
    0x12E: bytes.fromhex("F8E597C9D607472166DDCF6FA1947463"),
    0x139: bytes.fromhex("ED031C13C623787A8B401451BF6832BA"),
    0x13D: bytes.fromhex("20CA68D51B31E2DA080AD4DE9CE4355B"),
    0x14C: bytes.fromhex("163559159A2A97B80E4E30CCB30701AD"),
    0x14D: bytes.fromhex("1A658196C0DF1192D361C6958C2921B5"),
    0x187: bytes.fromhex("7FED17C27CEB442101FADB154A6B2305"),
    0x1A4: bytes.fromhex("69BB54E64E468D7BEA87E9B363CEF8BF"),
    0x1AB: bytes.fromhex("13219B6A9A62D46518F1AB163289E726"),
    0x1F0: bytes.fromhex("2F3C226018EB6376C5910F2734047F02"),
    0x20A: bytes.fromhex("9DE836A1CA3B1D33E0D5BB5FAE3C319F"),
    0x26B: bytes.fromhex("CECCBD69A13C18760F04F23A93241951"),
    0x30C: bytes([0x0F] * 16),
    0x30F: bytes([0x0C] * 16),
    0x324: bytes([0x27] * 16),
    0x3BE: bytes.fromhex("1F28C685E6F8B0195B643521E4F79C24"),
    0x3C0: bytes([0xC3] * 16),
    0x3D5: bytes.fromhex("C539C7F992D824CEF1B57AC4BC60E3D1"),
    0x65D: bytes.fromhex("ACB3ABEB7AE13BF773BA7C9E065F02D9"),
}

#: Identifier -> first value of the exclusive or.
MLB_STARTS = {
    0x109: 0x08,
    0x111: 0x10,
    0x30C: 0x0F,
    0x324: 0x27,
    0x10B: 0x0A,
    0x10D: 0x0C,
    0x10F: 0x0E,
    0x311: 0x12,
    0x397: 0x94,
    0x10C: 0x0D,
}
