import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.pose import QuantisedPose
from swarm import controls as controls_module
from swarm.controls import EVICTED, READMITTED, Controls, StartPose
from swarm.drops import Drop
from swarm.limits import MAX_COORDINATE_MM, MAX_REVISION
from swarm.messages import Control, decode, encode

POSE = StartPose(QuantisedPose(2150, -1450, 65535), b"session1")

revisions = st.integers(1, 4)
issuers = st.sampled_from([b"operator", b"observer", b"r1\0\0\0\0\0\0"])
evictions = st.builds(
    Control,
    st.just(Control.EVICT),
    st.sampled_from([b"session1", b"session2"]),
    revisions,
    issuers,
    st.sampled_from([EVICTED, READMITTED]),
)
poses = st.builds(
    Control,
    st.just(Control.START_POSE),
    st.sampled_from([b"r1", b"r2"]),
    revisions,
    issuers,
    st.integers(-3, 3).map(lambda x: StartPose(QuantisedPose(x, 0, 0), None).pack()),
)
records = st.lists(evictions | poses, max_size=12)


def table(*controls):
    made = Controls()
    for control in controls:
        made.put(control)
    return made


def contents(controls):
    return [*controls], controls.check, controls.evicted


@given(records, st.randoms())
def test_the_records_in_force_do_not_depend_on_order_or_repetition(given_records, chance):
    again = given_records * 2
    chance.shuffle(again)
    assert contents(table(*given_records)) == contents(table(*again))


@given(records, records)
def test_tables_that_are_merged_either_way_are_equal(some, others):
    one, other = table(*some), table(*others)
    for control in [*one]:
        other.put(control)
    for control in [*table(*others)]:
        one.put(control)
    assert contents(one) == contents(other)


@given(records)
def test_equal_checks_mean_equal_tables_and_the_empty_one_has_zero(given_records):
    made = table(*given_records)
    assert (made.check == 0) == (not given_records)
    assert table(*made).check == made.check
    if len(made):
        assert table(*[*made][1:]).check != made.check


@given(records)
def test_only_what_is_news_is_taken(given_records):
    made = Controls()
    for control in given_records:
        before = contents(made)
        assert made.put(control) == (contents(made) != before)


def test_the_greater_revision_wins_then_the_issuer_then_the_value():
    def evict(revision, issuer, value):
        return Control(Control.EVICT, b"session1", revision, issuer, value)

    rising = [
        evict(1, b"zzzzzzzz", EVICTED),
        evict(2, b"observer", EVICTED),
        evict(2, b"operator", READMITTED),
        evict(2, b"operator", EVICTED),
        evict(3, b"aaaaaaaa", READMITTED),
    ]
    made = Controls()
    for control in rising:
        assert made.put(control)
        assert [*made] == [control]
        assert made.evicted == ({b"session1"} if control.value == EVICTED else set())
    assert not any(made.put(control) for control in rising)


def test_what_is_decided_next_supersedes_what_is_in_force():
    made = Controls()
    for n, value in enumerate((EVICTED, READMITTED, EVICTED)):
        control = made.next(Control.EVICT, b"session1", b"observer", value)
        assert control.revision == n + 1
        assert made.put(control)
    made.put(Control(Control.EVICT, b"session1", MAX_REVISION, b"observer", EVICTED))
    with pytest.raises(ValueError, match="cannot be superseded"):
        made.next(Control.EVICT, b"session1", b"observer", READMITTED)


@pytest.mark.parametrize("session", [b"session1", None])
def test_a_start_pose_comes_back_as_it_was_given(session):
    made = Controls()
    given_pose = StartPose(QuantisedPose(-MAX_COORDINATE_MM, MAX_COORDINATE_MM, 65535), session)
    made.put(decode(encode(made.next(Control.START_POSE, b"r1", b"observer", given_pose.pack()))))
    assert made.start_pose("r1") == given_pose
    assert made.start_pose("r2") is None


@pytest.mark.parametrize(
    ("setting", "subject", "value"),
    [
        (Control.EVICT, b"session", EVICTED),
        (Control.EVICT, b"session01", EVICTED),
        (Control.EVICT, b"session1", b"\2"),
        (Control.EVICT, b"session1", b"\1\0"),
        (Control.START_POSE, b"r 1", POSE.pack()),
        (Control.START_POSE, b"\xff", POSE.pack()),
        (Control.START_POSE, b"r1\n", POSE.pack()),
        (Control.START_POSE, b"r1", POSE.pack()[:-1]),
        (Control.START_POSE, b"r1", StartPose(QuantisedPose(MAX_COORDINATE_MM + 1, 0, 0), None).pack()),
        (Control.START_POSE, b"r1", StartPose(QuantisedPose(0, -(2**31), 0), None).pack()),
    ],
)
def test_a_record_that_says_nothing_of_its_setting_is_dropped(setting, subject, value):
    made = Controls()
    with pytest.raises(Drop) as drop:
        made.put(Control(setting, subject, 1, b"observer", value))
    assert drop.value.reason == "bad_control"
    assert contents(made) == ([], 0, set())


def test_records_are_bounded_and_known_subjects_may_still_change(monkeypatch):
    monkeypatch.setattr(controls_module, "MAX_CONTROLS", 3)
    made = table(*[Control(Control.EVICT, bytes([k] * 8), 1, b"observer", EVICTED) for k in range(3)])
    with pytest.raises(Drop) as drop:
        made.put(Control(Control.EVICT, b"session1", 1, b"observer", EVICTED))
    assert drop.value.reason == "too_many"
    assert made.put(Control(Control.EVICT, bytes(8), 2, b"observer", READMITTED))
    assert len(made) == 3


@given(records)
def test_the_plain_client_has_the_same_check(plain_client, given_records):
    client = plain_client.Client()
    for control in given_records:
        client.take(encode(control))
    made = table(*given_records)
    assert client.controls_check == made.check
