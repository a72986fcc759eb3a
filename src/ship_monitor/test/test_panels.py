"""Content of the panels for simulated minutes with a shifted star sensor."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.models import ColumnDataSource, Div

from ship_geometry.rotations import ARCSEC
from ship_monitor.page.panels import Panels, event_row, input_row, reasons_text
from ship_monitor.plots.alignment_panel import bars_arcsec, half_width, state_text
from ship_monitor.plots.innovation_panel import InnovationPanel, source_line
from ship_monitor.plots.sky_panel import boresight, positions_in_field, used_star_mask
from ship_monitor.themes import THEMES
from ship_testing.monitored_histories import NOW_NS, SHIFT_AGE_S, simulated_history, simulated_state
from ship_watch.history.history import History, ParameterEstimate
from ship_watch.suite_state import Event, InputState, Presence

PICTURE = simulated_state()
EXCLUDED, GOOD = PICTURE.sources[0], PICTURE.sources[1]


@pytest.fixture
def panels():
    return Panels(THEMES["dusk"])


def test_empty_suite_has_empty_panels_with_notes(panels) -> None:
    panels.update(History(), replace(PICTURE, utc_ns=0, angles=(), sources=(), inputs=(), events=()))
    texts = " ".join(div.text for div in panels.layout.select({"type": Div}))
    for note in (
        "no innovations yet",
        "no truth data",
        "no error budget data",
        "no alignment or calibration data",
        "no input health data",
        "no events yet",
    ):
        assert note in texts


@pytest.mark.slow
def test_innovations_use_the_room_of_errors_without_truth(panels) -> None:
    panels.update(simulated_history(has_truth=True), PICTURE)
    assert panels.frames["error"].visible
    assert "'innovations error' 'innovations budget'" in panels._grid.css
    panels.update(simulated_history(has_truth=False), PICTURE)
    assert not panels.frames["error"].visible
    assert "'innovations budget' 'innovations events'" in panels._grid.css
    assert "error" not in panels._grid.css


@pytest.mark.slow
def test_sky_uses_the_room_of_lights_without_a_telescope(panels) -> None:
    history = simulated_history()
    panels.update(replace(history, beacons={}), PICTURE)
    assert not panels.frames["lights"].visible
    assert "'sky sky'" in panels._grid.css
    panels.update(history, PICTURE)
    assert panels.frames["lights"].visible
    assert "'sky lights'" in panels._grid.css


def test_height_of_errors_follows_the_recent_values(panels) -> None:
    history = simulated_history(length_s=50.0)
    points = history.errors["ship/error_arcsec"]
    history.errors["ship/error_arcsec"] = deque(
        replace(point, sigma=dict.fromkeys(point.sigma, 60.0)) if index < 25 else point
        for index, point in enumerate(points)
    )
    panels.update(history, PICTURE)
    heights = {key[1]: row._height.end for key, row in panels._errors.plots.rows.items()}
    assert heights == {"heading": 15.0, "pitch": 15.0, "roll": 15.0, "azimuth_cos_elevation": 15.0, "elevation": 15.0}
    history.errors["ship/error_arcsec"] = deque(replace(point, sigma={"roll": 8.0}) for point in points)
    panels.update(history, PICTURE)
    row = panels._errors.plots.rows[("ship/error_arcsec", "roll")]
    assert row._height.end == 30.0
    assert row.figure.title.text == "roll · axis ±30″"


def test_shifted_sensor_is_shown_rejected_and_shaded(panels) -> None:
    panels.update(simulated_history(), PICTURE)
    row = panels._innovations.plots.rows["star.starboard"]
    right = row._trails[1].source.data
    times, rejected, used = (np.asarray(right[name]) for name in ("t", "refused", "used"))
    shifted_ms = (NOW_NS - SHIFT_AGE_S * 1e9) * 1e-6
    assert np.nanmin(times[np.isfinite(rejected)]) >= shifted_ms
    assert np.nanmax(times[np.isfinite(used)]) <= shifted_ms
    assert np.nanmean(rejected) == pytest.approx(49.0, abs=2.0)
    assert row._height.end == 60.0
    assert row._out.data == {"start": [shifted_ms], "end": [NOW_NS * 1e-6]}
    assert row.figure.title.text.startswith("✕ star.starboard  OUT · axis ±60″")
    assert row.figure.title.text_color == THEMES["dusk"].caution_border
    assert "■ right +49." in " ".join(row._labels._axis.major_label_overrides.values())


@pytest.mark.slow
def test_past_outages_stay_shaded(panels) -> None:
    panel: InnovationPanel = panels._innovations
    history = simulated_history()
    for now_s, since_s in ((0, -40), (5, -40), (10, None), (20, 15), (22, 15)):
        source = (
            replace(EXCLUDED, out_since_ns=NOW_NS + since_s * 10**9) if since_s else replace(GOOD, name=EXCLUDED.name)
        )
        panel.update(history, replace(PICTURE, utc_ns=NOW_NS + now_s * 10**9, sources=(source,)), "", has_truth=True)
    now_ms = NOW_NS * 1e-6
    out = panel.plots.rows["star.starboard"]._out.data
    assert out["start"] == pytest.approx([now_ms - 40e3, now_ms + 15e3])
    assert out["end"] == pytest.approx([now_ms + 5e3, now_ms + 22e3])


@pytest.mark.slow
def test_outage_is_removed_after_a_step_back_in_time(panels) -> None:
    history = simulated_history()
    panels.update(history, PICTURE)
    out = panels._innovations.plots.rows["star.starboard"]._out
    for seconds, spans in ((20, [(-40.0, -20.0)]), (60, [])):
        earlier = replace(PICTURE, utc_ns=NOW_NS - seconds * 10**9, sources=(GOOD,))
        panels.update(history, earlier)
        ends = [(start - NOW_NS * 1e-6) * 1e-3 for name in ("start", "end") for start in out.data[name]]
        assert ends == pytest.approx([end for span in zip(*spans, strict=True) for end in span])


def test_wide_band_does_not_hide_the_values(panels) -> None:
    history = simulated_history()
    wide = [
        replace(p, sigma=p.sigma * (400.0 if p.utc_ns > NOW_NS - 20 * 10**9 else 1.0))
        for p in history.innovations["lights"]
    ]
    history.innovations["lights"] = deque(wide)
    panels.update(history, PICTURE)
    assert panels._innovations.plots.rows["lights"]._height.end == 15.0


@pytest.mark.parametrize(
    ("source", "step", "line"),
    [
        (GOOD, 15.0, ("✓ star.fore  IN · σ as stated (1.01)", False)),
        (GOOD, 30.0, ("✓ star.fore  IN · axis ±30″ · σ as stated (1.01)", False)),
        (replace(GOOD, nis_consistency=None), 15.0, ("✓ star.fore  IN", False)),
        (replace(GOOD, presence=Presence.OUT, reason="no data"), 15.0, ("✕ star.fore  OUT · no data", True)),
        (
            replace(EXCLUDED, name="star.fore"),
            60.0,
            ("✕ star.fore  OUT · axis ±60″ · 81 rejected in a row · reads 49″ high · residual 8.1 σ", True),
        ),
        (None, 15.0, ("star.fore", False)),
    ],
)
def test_title_of_a_source_plot(source, step, line) -> None:
    assert source_line("star.fore", source, step) == line


def test_only_new_points_are_streamed(panels) -> None:
    history = simulated_history()
    panels.update(history, PICTURE)
    sent = []
    for model in panels.layout.select({"type": ColumnDataSource}):
        model.on_change("data", lambda name, old, new: sent.append(name))
    panels._innovations.update(history, PICTURE, "", has_truth=True)
    panels._errors.update(history, "")
    assert sent == []


def test_few_messages_are_sent_to_a_browser_per_second(panels) -> None:
    # Each message is packed and sent separately: forty a second for each of three browsers take a tenth of a core.
    history = simulated_history()
    document = Document()
    document.add_root(panels.layout)
    panels.update(history, PICTURE)
    panels.visible_panels = {"innovations", "error", "budget"}
    sent = []
    document.on_change(sent.append)
    for second in range(1, 11):
        for points in (*history.innovations.values(), *history.errors.values(), *history.budgets.values()):
            points.append(replace(points[-1], utc_ns=points[-1].utc_ns + 10**9))
        panels.update(history, replace(PICTURE, utc_ns=NOW_NS + second * 10**9))
    # Two lines of each of three sources, five errors and the budget are streamed; the time axis moves, a shade grows,
    # and changed labels are sent.
    assert len(sent) <= 10 * (2 * 3 + 5 + 1 + 2 + 1 + 6)


def test_new_points_do_not_recompute_the_document_models(panels, monkeypatch) -> None:
    # Bokeh recomputes all models if one is added or removed, which takes 50 ms or more for each browser.
    history = simulated_history()
    panels.update(history, PICTURE)
    document = Document()
    document.add_root(panels.layout)
    looks = []
    recompute = type(document.models).recompute
    monkeypatch.setattr(type(document.models), "recompute", lambda self: (looks.append(1), recompute(self)))
    for second in range(1, 4):
        for points in (*history.innovations.values(), *history.errors.values(), *history.budgets.values()):
            points.append(replace(points[-1], utc_ns=points[-1].utc_ns + 10**9))
        panels.update(history, replace(PICTURE, utc_ns=NOW_NS + second * 10**9))
    assert looks == []
    panels.choose("roll")
    panels.update(history, PICTURE)
    assert 1 <= len(looks) <= 3  # not once for each band


def test_rejected_stars_differ_and_rows_count_downward() -> None:
    seen = simulated_history().star_exposures["star.fore"]
    seen = replace(
        seen,
        u=np.array([0.0, 1000.0]),
        v=np.array([0.0, 2000.0]),
        residual_right=np.array([1e-5, np.nan]),
        residual_up=np.array([0.0, np.nan]),
    )
    assert list(used_star_mask(seen)) == [True, False]
    across, up = positions_in_field(seen)
    assert (across[0], up[0]) == (-1.0, 1.0)  # the first column is left, the first row is up
    assert across[1] == pytest.approx(2.0 * 1000.0 / 1024.0 - 1.0)
    assert up[1] == pytest.approx(1.0 - 2.0 * 2000.0 / 2048.0)
    assert list(used_star_mask(replace(seen, residual_right=np.empty(0), residual_up=np.empty(0)))) == [True, True]


@pytest.mark.parametrize(
    ("installed_deg", "deck_deg", "expected_deg"),
    [
        ((0.0, 45.0), (30.0, 0.0, 0.0), (30.0, 45.0)),
        ((90.0, 45.0), (300.0, 0.0, 0.0), (30.0, 45.0)),
        ((0.0, 45.0), (10.0, 5.0, 0.0), (10.0, 50.0)),  # bow up
        ((180.0, 45.0), (10.0, 5.0, 0.0), (190.0, 40.0)),
        ((90.0, 45.0), (0.0, 0.0, 5.0), (90.0, 40.0)),  # port up: starboard goes down
    ],
)
def test_boresight_from_installation_and_attitude(installed_deg, deck_deg, expected_deg) -> None:
    alignment = [
        ParameterEstimate(f"star.aft.{name}", np.deg2rad(value), 0.0, "rad", True)
        for name, value in zip(("azimuth", "elevation"), installed_deg, strict=True)
    ]
    angles = [
        replace(PICTURE.angles[0], name=name, value=np.deg2rad(value))
        for name, value in zip(("heading", "pitch", "roll"), deck_deg, strict=True)
    ]
    assert np.rad2deg(boresight("star.aft", alignment, angles)) == pytest.approx(expected_deg)
    assert np.isnan(boresight("star.fore", alignment, angles)).all()
    assert np.isnan(boresight("star.aft", alignment, angles[:2])).all()


def test_states_are_deviations_from_nominal_with_two_sigma() -> None:
    angle = ParameterEstimate("star.a.azimuth", 2 * np.pi - 1 * ARCSEC, 0.6 * ARCSEC, "rad", True, 1.5 * ARCSEC)
    low, value, high = bars_arcsec([angle, replace(angle, unit="s"), replace(angle, nominal=float("nan"))])
    assert (low[0], value[0], high[0]) == pytest.approx((-3.7, -2.5, -1.3), abs=1e-6)
    assert np.isnan(value[1:]).all()
    assert state_text(angle) == "−2.5 ± 1.2″"
    assert state_text(replace(angle, is_observable=False)) == "(−2.5 ± 1.2″)"
    assert state_text(ParameterEstimate("t", 3.5e-4, 2e-5, "s", True, 0.0)) == "+0.35 ± 0.04 ms"
    assert state_text(ParameterEstimate("f", 0.100027, 5.5e-6, "m", True, 0.1)) == "+27 ± 11 µm"
    assert state_text(ParameterEstimate("u", 0.25, 0.4, "px", True, 0.0)) == "+0.25 ± 0.80 px"
    assert state_text(ParameterEstimate("star.a.focal_length", 2e-4, 1e-5, "1", True, 0.0)) == "+0.0200 ± 0.0020 %"


def test_axis_of_the_states_contains_all_values_and_most_bars() -> None:
    value, reach = np.array([1.0, 2.0, 70.0, -3.0, 0.0]), np.array([5.0, 5.0, 2.0, 4000.0, 9.0])
    assert half_width(value - reach, value + reach) == 120.0
    nothing = np.full(2, np.nan)
    assert half_width(nothing, nothing) == 30.0


def test_large_deviation_has_its_own_scale(panels) -> None:
    history = simulated_history()
    panels.update(history, PICTURE)
    states = panels._alignment
    before, rows = states._x.end, len(history.alignment)
    others = dict(states._values._axis.major_label_overrides)
    gyro = ParameterEstimate("reference.gyro.heading", 1000.0 * ARCSEC, 30.0 * ARCSEC, "rad", True, 0.0)
    history.alignment = (*history.alignment, gyro)
    panels.update(history, PICTURE)
    assert states._x.end == before
    assert np.abs(states._source.data["value"][rows]) <= states._x.end
    labels = states._values._axis.major_label_overrides
    assert labels[rows] == "+1000.0 ± 60.0″ · scale ±1200″"
    assert all(labels[row] == others[row] for row in range(rows))


def test_missing_position_is_stated_in_the_sky_panel() -> None:
    history = replace(simulated_history(), position=None)
    for is_bag, where in ((True, " in this bag"), (False, "")):
        panels = Panels(THEMES["dusk"], is_bag=is_bag)
        panels.update(history, PICTURE)
        assert panels._sky.box._head.text.endswith(f"residuals · Moon not drawn: no GNSS position{where}</span>")


def test_input_of_a_faulty_source_is_highlighted() -> None:
    shown = InputState("star/starboard/observations", 2.0, 0.1, 0.6, 0, 0, {})
    row = input_row(shown, {shown.topic: EXCLUDED})
    assert "class='guilty'" in row
    assert "<td class='n'>81" in row
    assert "OUT: 81 rejected in a row" in row
    assert "guilty" not in input_row(shown, {})
    assert "guilty" not in input_row(shown, {shown.topic: replace(EXCLUDED, because_of="ins")})


def test_only_the_marked_source_is_highlighted(panels) -> None:
    theme, history = THEMES["dusk"], simulated_history()
    event = Event(NOW_NS, "source", "star.fore", "star.fore IN")
    picture = replace(PICTURE, events=(*PICTURE.events, event))

    def highlights() -> dict[str, list[str]]:
        budget, states, rows = panels._budget, panels._alignment, panels._innovations.plots.rows
        squares = panels._sky._map._squares.data
        tables = {"events": panels._events._table.text, "inputs": panels._inputs._table.text}
        return {
            "innovations": [name for name, row in rows.items() if row.figure.title.text.startswith("▶")],
            "frames": [name for name, row in rows.items() if row.figure.outline_line_color == theme.text],
            "fields": [name for name, f in panels._sky._fields.items() if f.figure.outline_line_color == theme.text],
            "map": [str(width) for width in squares["width"] if width > 2.0],
            "lights": ["frame"] if panels._lights.figure.outline_line_color == theme.text else [],
            "bands": [
                band
                for band, drawn in zip(budget._bands, budget._band_renderers, strict=False)
                if drawn.glyph.fill_color == theme.text
            ],
            "states": [
                state.name
                for state, bar in zip(
                    [*history.alignment, *history.calibration], states._source.data["bar"], strict=True
                )
                if bar == theme.text
            ],
            **{name: [row for row in table.split("<tr")[1:] if "marked" in row] for name, table in tables.items()},
        }

    panels.update(history, picture)
    assert not any(highlights().values())
    panels.marked = "star.fore"
    panels.update(history, picture)
    found = highlights()
    assert found["innovations"] == found["frames"] == found["fields"] == ["star.fore"]
    assert len(found["map"]) == 1
    assert found["lights"] == []
    assert set(found["bands"]) == {"installation", "star_noise"}
    assert found["states"] == ["star.fore.azimuth"]
    assert [len(found[name]) for name in ("events", "inputs")] == [1, 1]
    assert "▶ star/" in found["inputs"][0]
    panels.marked = "lights"
    panels.update(history, picture)
    found = highlights()
    assert found["innovations"] == ["lights"]
    assert found["lights"] == ["frame"]
    assert found["fields"] == found["states"] == []
    panels.marked = "weather"
    panels.update(history, picture)
    assert highlights()["bands"] == ["refraction"]  # the smallest part of the budget has a band of its own
    panels.marked = ""
    panels.update(history, picture)
    assert not any(highlights().values())


def test_only_the_error_of_the_chosen_angle_is_highlighted(panels) -> None:
    history = simulated_history()
    panels.update(history, PICTURE)
    titles = [row.figure.title.text for row in panels._errors.plots.rows.values()]
    panels.choose("roll")
    panels.update(history, PICTURE)
    chosen = [row.figure.title.text for row in panels._errors.plots.rows.values()]
    assert [text for text in chosen if text not in titles] == ["▶ roll"]
    assert panels._budget.box._head.text.count("roll, σ")


def test_invisible_panel_is_not_drawn_and_catches_up(panels) -> None:
    history = simulated_history()
    panels.update(history, PICTURE)
    panels.visible_panels = {"inputs"}
    before = {id(model): model.data for model in panels.layout.select({"type": ColumnDataSource})}
    for points in (*history.innovations.values(), *history.errors.values(), *history.budgets.values()):
        points += [replace(points[-1], utc_ns=points[-1].utc_ns + second * 10**9) for second in (1, 2, 3)]
    panels.update(history, replace(PICTURE, utc_ns=NOW_NS + 3 * 10**9))
    sources = panels.layout.select({"type": ColumnDataSource})
    assert all(model.data is before[id(model)] for model in sources)
    row = panels._errors.plots.rows["ship/error_arcsec", "roll"]
    rows = len(row._trail.source.data["t"])
    panels.visible_panels = {"error"}
    panels.update(history, replace(PICTURE, utc_ns=NOW_NS + 3 * 10**9))
    assert len(row._trail.source.data["t"]) == rows + 3


def test_reasons_are_sorted_and_names_are_escaped() -> None:
    assert reasons_text({"gate": 9, "too_few_stars": 56, "late": 0}) == "too few stars 56, gate 9"
    assert reasons_text({}) == "—"
    assert reasons_text(dict.fromkeys("abcdef", 9)).endswith(", 2 more")
    shown = InputState("<script>alert(1)</script>", 2.0, 0.1, 0.6, 0, 0, {"<b>": 1})
    assert "<script>" not in input_row(shown, {})
    assert "&lt;b&gt;" in input_row(shown, {})
    event = event_row(Event(NOW_NS, "mode", "theodolite/pointing", "<i>2 lights"))
    assert event == "<tr><td class=time>12:00:07<td>theodolite/pointing: &lt;i&gt;2 lights"
