"""A serial device server that speaks RFC 2217, in front of a simulator's TCP port. pyserial implements the protocol."""

from __future__ import annotations

import contextlib
import socket
import threading

import serial
from serial.rfc2217 import PortManager


class Rfc2217Server:
    """Serves one client at a time on a free port of loopback."""

    def __init__(self, device_url: str) -> None:
        self._device_url = device_url
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"rfc2217://127.0.0.1:{self._listener.getsockname()[1]}"
        self.baud = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="rfc2217 server")
        self._thread.start()

    def stop(self) -> None:
        """End the connection and the thread."""
        self._stopping.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(20)

    def _serve(self) -> None:
        while not self._stopping.is_set():
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            with client, serial.serial_for_url(self._device_url, timeout=0.02) as device:
                self._redirect(client, device)

    def _redirect(self, client: socket.socket, device: serial.SerialBase) -> None:
        lock = threading.Lock()

        class Locked:
            """PortManager writes its own answers from this side while data passes."""

            def write(self, data: bytes) -> None:
                with lock, contextlib.suppress(OSError):
                    client.sendall(data)

        manager, ended = PortManager(device, Locked()), threading.Event()

        def to_client() -> None:
            while not ended.is_set() and not self._stopping.is_set():
                data = device.read(1)
                if data:
                    device.timeout = 0
                    data += device.read(4096)
                    device.timeout = 0.02
                    with lock, contextlib.suppress(OSError):
                        client.sendall(b"".join(manager.escape(data)))

        thread = threading.Thread(target=to_client)
        thread.start()
        client.settimeout(0.2)
        try:
            while not self._stopping.is_set():
                try:
                    data = client.recv(4096)
                except TimeoutError:
                    continue
                except OSError:
                    return
                if not data:
                    return
                device.write(b"".join(manager.filter(data)))
                self.baud = device.baudrate
        finally:
            ended.set()
            thread.join()
