"""The cases that are requests one by one, each with its answer."""

from conformance_kit import COMMAND, NO_INDEX, NO_SUB, NO_WRITE, G, Tester, filled, hexes, little

OK = "60"
TOO_LONG, TOO_SHORT = ("06070010", "06070012", G), ("06070010", "06070013", G)
INVALID, TOO_HIGH = ("06090030",), ("06090030", "06090031", G)
NO_PERIOD, PRODUCER_OFF = ("23 06 10 00", OK), ("23 05 10 00 80 00 00 00", OK)
NO_COUNTER = ("40 19 10 00", "4F 19 10 00 00")
# By case: requests, and what must come without the zeros at the end: the answer, or one of these abort codes.
EXCHANGES: dict[str, list[tuple[str, str | tuple[str, ...]]]] = {
    "sdo_01": [("40 00 10 00", "43 00 10 00 {device_type}")],
    "sdo_02": [("40 17 10 00", "4B 17 10 00"), ("2B 17 10 00", OK)],
    "sdo_03": [("23 00 10 00 {device_type}", NO_WRITE), ("40 00 10 00", "43 00 10 00 {device_type}")],
    "sdo_05": [("40 00 10 01", NO_SUB)],
    "sdo_06": [("40 04 10 00", NO_INDEX)],
    "sdo_07": [("E0 00 10 00", COMMAND)],
    "sdo_08": [("23 03 10 00", TOO_LONG), ("23 17 10 00", TOO_LONG)],
    "sdo_09": [("2F 05 10 00 80", TOO_SHORT), ("2F 17 10 00 80", TOO_SHORT)],
    # CiA 301, 7.5.2.4: this code, and no maximum in the EDS
    "sdo_10": [("2F 03 10 00 FF", TOO_HIGH), ("2F 03 10 00 01", INVALID)],
    "sdo_12": [("40 00 12 01", "43 00 12 01 {sdo_request}"), ("40 00 12 02", "43 00 12 02 {sdo_answer}")],
    "sdo_14": [("21 0C 10 00 02", OK), ("0B E8 03", "20"), ("40 0C 10 00", "4B 0C 10 00 E8 03")],
    "sdo_15": [("21 17 10 00 02", OK), ("0B 10 27", "20"), ("40 17 10 00", "4B 17 10 00 10 27")],
    "sdo_26": [(f"A0 00 10 00 {size}", ("05040002",)) for size in ("80", "FF", "00")],
    "emcy_01": [("40 14 10 00", "43 14 10 00 {emergency}")],
    "emcy_02": [("40 01 10 00", "4F 01 10 00")],
    "emcy_03": [("40 03 10 00", "4F 03 10 00"), ("40 03 10 01", ("08000024",))],
    "sync_01": [("40 05 10 00", "43 05 10 00 80")],
    "sync_04": [PRODUCER_OFF, NO_PERIOD],
    "sync_05": [
        NO_PERIOD,
        ("2F 19 10 00 01", INVALID),
        *((f"2F 19 10 00 {overflow}", TOO_HIGH) for overflow in ("F1", "FF")),
        NO_COUNTER,
    ],
    "sync_09": [PRODUCER_OFF, ("23 06 10 00 E8 03", OK), ("2F 19 10 00 05", ("08000022",)), NO_COUNTER],
    "guard_01": [("40 0C 10 00", "4B 0C 10 00"), ("40 0D 10 00", "4F 0D 10 00")],
    "guard_05": [
        *(("2B 0C 10 00 F4 01", OK), ("2F 0D 10 00 03", OK)),
        *(("40 0C 10 00", "4B 0C 10 00 F4 01"), ("40 0D 10 00", "4F 0D 10 00 03")),
    ],
    "hb_01": [("2B 17 10 00", OK)],
    "hb_04": [("23 16 10 01 34 12 05 00", OK), ("23 16 10 02 34 12 05 00", ("06040043",))],
    "hvg_01": [("40 17 10 00", "4B 17 10 00"), ("40 0C 10 00", "4B 0C 10 00")],
}


def test_exchange(tester: Tester, case: str) -> None:
    words = {
        "device_type": hexes(tester.eds[0x1000, 0].default),
        "sdo_request": little(0x600 + tester.id, 4),
        "sdo_answer": little(0x580 + tester.id, 4),
        "emergency": little(0x80 + tester.id, 4),
    }
    for request, expected in EXCHANGES[case]:
        asked = request.format_map(words)
        if expected == OK:
            tester.accept(asked)
        elif isinstance(expected, str):
            assert tester.ask(asked) == filled(expected.format_map(words))
        else:
            tester.refuse(asked, *expected)
