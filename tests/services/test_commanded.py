"""An order counts as done by what the vehicle tells after its answer, whatever it told before."""

import pytest

from services.config import load
from services.px4_bridge.telemetry import Fields
from services.px4_bridge.vehicle_protocol import VehicleError
from services.rehearsal.direct_vehicle import DirectVehicle
from services.runtime.virtual import VirtualClock, run_virtual


class Mute(DirectVehicle):
    """Acknowledges at once and tells nothing; what was told last is: disarmed."""

    async def _acknowledged(self, fields: Fields) -> int:
        return 0


def test_what_was_told_before_an_order_does_not_show_that_it_was_obeyed():
    async def ordered() -> None:
        vehicle = Mute(load("demo").px4_bridge.vehicle, VirtualClock().now_ns, 0.0)
        assert not vehicle.sample.armed
        with pytest.raises(VehicleError, match="disarm: acknowledged, but not seen within 3 s"):
            await vehicle.disarm()

    run_virtual(ordered())
