"""Parameters of one module."""

from __future__ import annotations

from dataclasses import dataclass

from canfb.checks import integer_in, number_in, within
from canfb.cia301 import cob
from canfb.device.lss import UNCONFIGURED as UNCONFIGURED  # for readers of configurations
from canfb.objects import WriteLockMode
from canfb.signal.chain_config import ChainConfig
from canfb.signal.sample import MOST_PER_SYNC
from canfb.signal.second_position import SecondSensor
from canfb.sources.protocol import SourceConfig

LOWEST_COB_ID, HIGHEST_COB_ID = 0x181, 0x57F
MOST_GAP_BYTES = 4  # left beside an INTEGER32 in a PDO of 8 bytes
BYTE, TWO_BYTES, FOUR_BYTES = 0x00050008, 0x00060010, 0x00070020  # dummy objects (CiA 301, 7.4.4)
GAPS = ((), (BYTE,), (TWO_BYTES,), (TWO_BYTES, BYTE), (FOUR_BYTES,))  # by the number of bytes
VALUE = 0x20000E20


@dataclass(frozen=True, kw_only=True)
class SecondPositionConfig(SecondSensor):
    """The other sensor, and the PDO that carries its value.

    cob_id         of that PDO, 385..1407 (181h..57Fh), for the first free RPDO. None: a master maps 2000:0E
    before_bytes   bytes of that PDO before the value, 0..4
    after_bytes    bytes of that PDO after the value, 0..4; at most 4 in all
    """

    cob_id: int | None = None
    before_bytes: int = 0
    after_bytes: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        within(self, cob_id=(LOWEST_COB_ID, HIGHEST_COB_ID), before_bytes=(0, MOST_GAP_BYTES))
        within(self, after_bytes=(0, MOST_GAP_BYTES - self.before_bytes))

    @property
    def mapping(self) -> list[int]:
        """The mapping of its RPDO: the value between dummy objects."""
        return [*GAPS[self.before_bytes], VALUE, *GAPS[self.after_bytes]]


RPDOS = 4
MOST_ACCELERATION_RAD_S2 = 1e9  # 2010:02
MOST_DECLARED_S = 1.0  # 2010:0D, 2010:0E


WITHOUT_BUS = {  # keys of a chain without a bus, and what a module has instead
    "max_acceleration_cycles": "max_acceleration_rad_s2",
    "interval_s": "a module measures it, or reads 1006h",
}
WRITE_LOCKS = {"none": WriteLockMode.OFF, "preop": WriteLockMode.PREOP, "code": WriteLockMode.CODE}


@dataclass(frozen=True, kw_only=True)
class ModuleConfig(ChainConfig):
    """One drive feedback module: the fields of ChainConfig, and its place on the bus.

    node_id                  of the module, 1..127, required; 255: assigned by an LSS master. A node-ID stored
                             by LSS in state_dir takes precedence
    serial_number            0..4294967295 (1018:04): distinguishes equal modules for an LSS master
    encoder_interface        node-ID of the encoder interface, whose TPDO1 carries the ADC counts, 1..127; not
                             node_id. Not used with a source
    times                    True: the ADC PDO carries the interface's sample time after sine and cosine
                             (RPDO1: 2000:01, :02, :05), 8 bytes; with several samples, the first PDO with
                             room for it. Not used with a source
    samples_per_sync         1..8 pairs of sine and cosine for each SYNC, two in each TPDO of the encoder
                             interface (2000:01, :02, :08..0D, :0F..16), then the time: with ``times`` at
                             most 7. Also the pairs from a source of kind iio
    source                   source of the samples; None: the ADC PDO
    max_acceleration_rad_s2  largest acceleration of the machine, 0..1e9 (2010:02); 0: not known
    noise_margin             0..255 (2010:09): margin of a residual limit narrowed by the acceleration, in
                             standard deviations of the measured noise, if less than the fixed margin; 0: the
                             fixed margin. 6 is usual
    predict                  position in synchronous TPDOs, 0..2 (2013:01): False or 0: measured; True or 1:
                             extrapolated to their SYNC at constant speed; 2: at constant acceleration
    nominal_sync             True: with ``times`` the position is that of a SYNC without jitter (2013:02)
    sync_timeout_periods     2..255 periods without SYNC or sample until the position is not valid
                             (2010:06)
    answer_delay_s           longest delay from SYNC to ADC PDO, 0..1 s (2010:0E); 0: less than a period
    second_position          another sensor of the machine, such as the motor encoder of the drive, to compare
                             with the position (2014h); None: none
    state_dir                folder for the data of `save` (1010h), relative to the working directory, created
                             if missing; None: nothing is saved. `canfb run` uses it; each module has its own
    autostart                True: OPERATIONAL without a master
    write_lock               when parameters, table and node-ID can be written over the bus (2040:01): "none":
                             always, "preop": not in OPERATIONAL, "code": only with unlock_code
    unlock_code              0..4294967295, for write_lock "code" (2040:02); 0: none
    """

    node_id: int
    serial_number: int = 0
    encoder_interface: int = 16
    times: bool = False
    samples_per_sync: int = 1
    source: SourceConfig | None = None
    max_acceleration_rad_s2: float = 0.0
    noise_margin: int = 0
    predict: bool | int = False
    nominal_sync: bool = False
    sync_timeout_periods: int = 2
    answer_delay_s: float = 0.0
    second_position: SecondPositionConfig | None = None
    state_dir: str | None = None
    autostart: bool = False
    write_lock: str = "none"
    unlock_code: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.node_id != UNCONFIGURED or not isinstance(self.node_id, int):
            integer_in("node_id", self.node_id, 1, 127)
        within(
            self,
            serial_number=(0, 0xFFFFFFFF),
            unlock_code=(0, 0xFFFFFFFF),
            encoder_interface=(1, 127),
            samples_per_sync=(1, MOST_PER_SYNC - bool(self.times and self.source is None)),
            noise_margin=(0, 255),
            sync_timeout_periods=(2, 255),
            answer_delay_s=(0.0, MOST_DECLARED_S),
            max_acceleration_rad_s2=(0.0, MOST_ACCELERATION_RAD_S2),
            times=bool,
            nominal_sync=bool,
            autostart=bool,
            state_dir=str,
        )
        for name, value in self.conditioning.words.items():
            number_in(f"conditioning: {name}", value, -3.4e38, 3.4e38)  # REAL32
        source, second = self.source, self.second_position
        if source is not None and not isinstance(source, SourceConfig):
            raise ValueError(f"source must be a configuration of a source, not {source!r}")
        if second is not None and not isinstance(second, SecondPositionConfig):
            raise ValueError(f"second_position must be a SecondPositionConfig, not {second!r}")
        if second is not None and second.cob_id and self.adc_pdos >= RPDOS:
            raise ValueError(
                "second_position: no RPDO is left for cob_id beside the samples and their time: "
                "leave out times, or take fewer samples_per_sync"
            )
        if second is not None and second.cob_id in [tpdo + self.node_id for tpdo in cob.TPDOS]:
            raise ValueError(f"second_position: cob_id {second.cob_id:#x} is that of a PDO of the module")
        if source is None and self.encoder_interface == self.node_id:
            raise ValueError(f"encoder_interface must differ from node_id {self.node_id}")
        for name, instead in WITHOUT_BUS.items():
            if getattr(self, name):
                raise ValueError(f"{name} belongs to a chain without a bus: {instead}")
        if not isinstance(self.predict, int) or not 0 <= self.predict <= 2:
            raise ValueError(f"predict must be false, true, or 0, 1 or 2, not {self.predict!r}")
        if self.write_lock not in WRITE_LOCKS:
            raise ValueError(f"write_lock must be none, preop or code, not {self.write_lock!r}")
        if self.write_lock == "code" and not self.unlock_code:
            raise ValueError("write_lock: code needs an unlock_code, 1 to 4294967295")

    @classmethod
    def factory(cls, node_id: int, serial_number: int = 0) -> ModuleConfig:
        """The defaults, for any node-ID."""
        interface = cls.encoder_interface + (node_id == cls.encoder_interface)
        return cls(node_id=node_id, serial_number=serial_number, encoder_interface=interface)

    @property
    def adc_pdos(self) -> int:
        """Number of RPDOs for the samples: each holds two pairs, or one and the time."""
        return (self.samples_per_sync + self.times + 1) // 2
