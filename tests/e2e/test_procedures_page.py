"""An operator writes a procedure and a derived parameter in a real browser, and runs the procedure on the simulated
sensor.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]
SLOW = 30_000
TEXT = """# Warm start

Prepare the sensor for measurements.

## ready: Check the temperature

The detector must not be warmer than 100 °C.

```check
housekeeping.sensor_temperature_c < 100
within: 60 s
```

## status: Ask for the status

```command
GET_STATUS
```

## dark: Look at the sky

```question
Is the sky dark?
yes: signed
no: end
```

## signed: Sign off

```sign
The warm start is complete.
```
"""


def test_an_operator_writes_and_runs_a_procedure(page: Page, picture: Callable[[str], None]) -> None:
    """The page shows a mistake with its line, runs and records each step, and shows the hash of the record. A question
    can be answered while the other steps run automatically. The next run is compared with this one."""
    page.goto("/procedures")
    page.get_by_test_id("procedure-new").click()
    page.get_by_test_id("procedure-text").fill(TEXT.replace("GET_STATUS", "GET_STATE"))
    mistakes = page.get_by_test_id("procedure-mistakes")
    expect(mistakes).to_contain_text("Line 17: unknown command", timeout=SLOW)
    page.get_by_label("Close", exact=True).click()
    page.get_by_test_id("procedure-keep").click()
    page.keyboard.press("g")
    page.keyboard.press("l")
    page.go_back()
    expect(page.get_by_test_id("procedure-text")).to_have_value(re.compile("GET_STATE"))
    page.get_by_test_id("procedure-text").fill(TEXT)
    expect(mistakes).to_contain_text("No errors", timeout=SLOW)
    page.get_by_test_id("procedure-save").click()
    page.locator("[data-procedure='Warm start']").get_by_test_id("procedure-start").click(timeout=SLOW)
    for step in ("ready", "status"):
        shown = page.locator(f"[data-step={step}]")
        shown.get_by_test_id("procedure-run").click(timeout=SLOW)
        expect(shown.get_by_test_id("procedure-entry")).to_have_attribute("data-state", "done", timeout=SLOW)
    expect(page.locator("[data-step=ready]")).to_contain_text("housekeeping.sensor_temperature_c =")
    expect(page.locator("[data-step=dark]")).to_have_attribute("aria-current", "step", timeout=SLOW)
    picture("procedure")
    page.get_by_test_id("procedure-automatic").click()
    expect(page.get_by_test_id("procedure-run-view")).to_contain_text("step dark waits for an operator", timeout=SLOW)
    page.get_by_test_id("procedure-answer").filter(has_text="yes").click()
    page.locator("[data-step=signed]").get_by_test_id("procedure-note").fill("all well", timeout=SLOW)
    page.locator("[data-step=signed]").get_by_test_id("procedure-run").click()
    expect(page.get_by_test_id("procedure-hash")).to_contain_text("unchanged", timeout=SLOW)
    page.set_viewport_size({"width": 1440, "height": 700})
    expect(page.get_by_test_id("run-telemetry")).to_have_count(0)
    plots: list[str] = []
    page.on("request", lambda request: plots.append(request.url) if "/history" in request.url else None)
    page.locator("[data-procedure='Warm start']").get_by_test_id("procedure-start").click()
    compared = page.get_by_test_id("procedure-comparison")
    expect(compared).to_contain_text("compared with 1 earlier run", timeout=SLOW)
    expect(compared.get_by_role("row").filter(has_text="Sign off")).to_contain_text("done", timeout=SLOW)
    expect(page.get_by_test_id("run-telemetry")).to_have_count(0)
    assert plots == [], "no data of a plot that is not shown"
    page.set_viewport_size({"width": 1920, "height": 1080})
    expect(page.get_by_test_id("run-telemetry").get_by_test_id("plot-stack")).to_be_in_viewport()


def test_an_operator_defines_a_derived_parameter(page: Page) -> None:
    """The page checks the expression during input. The value of the parameter is shown there and on the telemetry
    page.
    """
    page.goto("/telemetry/derived")
    page.get_by_test_id("derived-name").fill("supply_twice_v")
    page.get_by_test_id("derived-expression").fill("2 * housekeeping.supply_3v3_v +")
    expect(page.get_by_test_id("derived-form")).to_contain_text("position 32", timeout=SLOW)
    page.get_by_test_id("derived-expression").fill("2 * housekeeping.supply_3v3_v")
    expect(page.get_by_test_id("derived-trial")).to_contain_text("With the latest values: 6.", timeout=SLOW)
    page.get_by_test_id("derived-unit").fill("V")
    page.get_by_test_id("derived-save").click()
    expect(page.locator("[data-derived=supply_twice_v]")).to_contain_text("6.", timeout=SLOW)
    page.goto("/telemetry?page=derived")
    expect(page.locator("[data-field='derived_supply_twice_v.supply_twice_v']")).to_contain_text("6.", timeout=SLOW)
