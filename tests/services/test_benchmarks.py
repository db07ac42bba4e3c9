"""What the benchmarks make of a recording; their measurements are for a machine of their own."""

from benchmarks.flight_demo import CPU_COLUMNS, cpu_rows
from schemas.topics import HEALTH
from tests.services import synthetic
from tests.services.synthetic_world import Scenario


def test_a_service_that_was_not_there_has_no_row(tmp_path):
    gateways = {topic.key: set(range(1, 10_000)) for name, topic in HEALTH.items() if name.endswith("gateway")}
    synthetic.write(tmp_path / "session.mcap", Scenario(dropped=gateways))
    rows = cpu_rows(tmp_path)
    assert [row[0] for row in rows] == [name for name in HEALTH if not name.endswith("gateway")] + ["all"]
    assert {len(row) for row in rows} == {len(CPU_COLUMNS)}
