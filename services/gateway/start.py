"""What must be right before a gateway starts: certificates, address, and that this is the host the profile says."""

import ipaddress
import socket
from dataclasses import replace

from services.config import Config, ConfigError
from services.gateway import session
from services.gateway.certs import CertsError, Credentials, credentials, folder
from services.gateway.radio import Radio
from services.gateway.refusals import Refusals
from services.runtime.bus_config import BusConfig


def gateway_bus(config: Config, bus: BusConfig) -> BusConfig:
    """The bus of this host's gateway process: a router that owns the radio.

    Raises:
        ConfigError: one line that names file or key, value and limit.
    """
    host, radio = config.system.host, _radio(config)
    resolved = _resolve(radio.address)
    services = {name: each.services for name, each in config.hosts.items()}
    if host == "ground":
        _require_own(radio.address, resolved)
        files = _files(radio, _only_name(radio, host), host, radio.address)
        own = {"listen": session.endpoints(radio)}
    else:
        if _is_own(resolved):
            raise ConfigError(f"radio.address = {radio.address}: is this machine's own, but system.host = {host}")
        files = _files(radio, _only_name(radio, host), host)
        own = {"endpoints": session.endpoints(radio)}
    settings = session.gateway(host, radio, services, files, bus.prefix)
    return replace(bus, settings=settings, log=Refusals(bus.prefix), **own)


def console_bus(config: Config, bus: BusConfig) -> BusConfig:
    """The bus of a console: a client of the ground's gateway. Raises as `gateway_bus`."""
    radio = _radio(config)
    role = radio.role_of(radio.console)
    if role not in ("operator", "viewer"):
        raise ConfigError(f"radio.console = {radio.console!r}: must be an operator or a viewer of radio.names")
    _resolve(radio.address)
    files = _files(radio, radio.console, role)
    return replace(bus, settings=session.console(radio, files), endpoints=session.endpoints(radio))


def _radio(config: Config) -> Radio:
    if config.radio is None:
        raise ConfigError("radio: is missing: a gateway is for a system on two hosts")
    return config.radio


def _only_name(radio: Radio, role: str) -> str:
    names = radio.of_role(role)
    if len(names) != 1:
        raise ConfigError(f"radio.names: {len(names)} names of role {role}: must be one")
    return names[0]


def _files(radio: Radio, name: str, role: str, address: str = "") -> Credentials:
    try:
        return credentials(folder(), name, role, address)
    except CertsError as error:
        raise ConfigError(str(error)) from None


def _resolve(address: str) -> str:
    try:
        return str(socket.getaddrinfo(address, None, type=socket.SOCK_STREAM)[0][4][0])
    except OSError as error:
        raise ConfigError(f"radio.address = {address}: does not resolve: {error.strerror or error}") from None


def _is_own(resolved: str) -> bool:
    """Whether this machine has the address: only then can it be bound."""
    family = socket.AF_INET6 if ipaddress.ip_address(resolved).version == 6 else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((resolved, 0))
        except OSError:
            return False
    return True


def _require_own(address: str, resolved: str) -> None:
    if not _is_own(resolved):
        raise ConfigError(f"radio.address = {address} ({resolved}): is no address of this machine, the ground station")
