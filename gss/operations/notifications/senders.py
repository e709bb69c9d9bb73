"""Sends messages by mail or webhook with a timeout. Private addresses must be permitted explicitly."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import json
import os
import smtplib
import socket
import ssl
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from email.message import EmailMessage

import httpx2

from gss.domain.errors import LinkDown, NotPermitted
from gss.operations.notifications.rules_file import Mail, Target, Webhook

TIMEOUT_S = 10.0
TRANSLATED = ipaddress.ip_network("64:ff9b::/96")


@dataclass(frozen=True)
class OutgoingMessage:
    """A message to send. ``key``: identical for repeated attempts, so a receiver can drop duplicates."""

    key: str
    level: str
    subject: str
    text: str


class Sender:
    """Sends messages. ``private``: permit loopback, private and link-local addresses. ``environment``: contains the
    passwords."""

    def __init__(self, private: bool, environment: Mapping[str, str] = os.environ) -> None:
        self._private, self._environment = private, environment

    def send(self, target: Target, message: OutgoingMessage) -> str:
        """Send a message. Return a text that lists the recipients rejected by the server, "" if there are none. Raises LinkDown
        with the reason if the message was not accepted, NotPermitted for a private address."""
        try:
            self._check_address(target.host)
            if target.mail:
                return self._mail(target.mail, message)
            if target.webhook:
                self._post(target.webhook, message)
            return ""
        except (OSError, smtplib.SMTPException, httpx2.HTTPError) as error:
            reason = str(error) or type(error).__name__
            raise LinkDown(f"The message to {target.name} was not sent", got=reason[:300]) from error

    def _check_address(self, host: str) -> None:
        for *_, address in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM):
            if not self._private and not is_public(str(address[0]).split("%")[0]):
                raise NotPermitted(
                    f"{host} has the private address {address[0]}",
                    hint="set GSS_NOTIFICATIONS_PRIVATE to true if this is intended",
                )

    def _mail(self, mail: Mail, message: OutgoingMessage) -> str:
        email = EmailMessage()
        email["Subject"], email["From"], email["To"] = message.subject, mail.sender, ", ".join(mail.to)
        email["Message-ID"] = f"<{message.key}@gss.invalid>"
        email.set_content(message.text)
        secure = ssl.create_default_context()
        server = (
            smtplib.SMTP_SSL(mail.server, mail.port, timeout=TIMEOUT_S, context=secure)
            if mail.security == "tls"
            else smtplib.SMTP(mail.server, mail.port, timeout=TIMEOUT_S)
        )
        with closing(server):  # QUIT is not sent, because its answer says nothing about the message
            if mail.security == "starttls":
                server.starttls(context=secure)
            if mail.user:
                server.login(mail.user, self._environment.get(mail.password_env, ""))
            refused = server.send_message(email)
        return f"refused by the server: {', '.join(sorted(refused))}" if refused else ""

    def _post(self, webhook: Webhook, message: OutgoingMessage) -> None:
        body = json.dumps(asdict(message)).encode()
        headers = {"Content-Type": "application/json", "Idempotency-Key": message.key}
        if webhook.secret_env:
            secret = self._environment.get(webhook.secret_env, "").encode()
            headers["X-GSS-Signature"] = f"sha256={hmac.new(secret, body, hashlib.sha256).hexdigest()}"
        with httpx2.Client(timeout=TIMEOUT_S, trust_env=False, follow_redirects=False) as client:
            client.post(str(webhook.url), content=body, headers=headers).raise_for_status()


def is_public(address: str) -> bool:
    """True if the address is a global unicast address. An IPv6 address that represents an IPv4 address (RFC 6052) is treated as
    that IPv4 address."""
    ip = ipaddress.ip_address(address)
    if isinstance(ip, ipaddress.IPv6Address) and ip in TRANSLATED:
        ip = ipaddress.IPv4Address(int(ip) & 0xFFFFFFFF)
    return ip.is_global and not ip.is_multicast
