//! The position of the sun at a place and a time, by the crate `solar-positioning` (Reda and Andreas, "Solar position
//! algorithm for solar radiation applications", Solar Energy 76, 2004).

use std::{f64::consts::TAU, str::FromStr};

use solar_positioning::{Location, RefractionCorrection, SolarPositions, time::JulianDate};

/// A place on the Earth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Latitude in degrees, positive north of the equator.
    pub latitude: f64,
    /// Longitude in degrees, positive east of Greenwich.
    pub longitude: f64,
}

/// A date and a time of the day with its offset from UTC.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    year: i32,
    month: u32,
    day: u32,
    /// Hours of the local day, from 0 to 24.
    hours: f64,
    /// Hours that local time is ahead of UTC.
    offset: f64,
}

/// Days of the months of a common year.
const DAYS: [u32; 12] = [31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];

impl Moment {
    /// Makes a moment from a local date and hour, and the hours that local time is ahead of UTC. `None` if there is no
    /// such day or hour, or if the year is outside 1900 to 2200.
    pub fn new(year: i32, month: u32, day: u32, hours: f64, offset: f64) -> Option<Moment> {
        let days = |month: usize| DAYS[month - 1] + u32::from(month == 2 && is_leap(year));
        let good = (1900..=2200).contains(&year)
            && (1..=12).contains(&month)
            && (1..=days(month as usize)).contains(&day)
            && (0.0..=24.0).contains(&hours)
            && (-24.0..=24.0).contains(&offset);
        good.then_some(Moment { year, month, day, hours, offset })
    }

    /// The number of the day in the year, from 1.
    pub fn day_of_year(&self) -> u32 {
        let before = self.month as usize - 1;
        let leap = u32::from(before > 1 && is_leap(self.year));
        DAYS[..before].iter().sum::<u32>() + leap + self.day
    }

    /// The factor of the solar constant on this day: the square of the mean distance of the sun over its distance on
    /// the day (Spencer, "Fourier series representation of the position of the sun", 1971).
    pub fn eccentricity(&self) -> f64 {
        let angle = TAU * f64::from(self.day_of_year() - 1) / 365.0;
        let (twice, cos, sin) = (2.0 * angle, angle.cos(), angle.sin());
        1.00011 + 0.034221 * cos + 0.00128 * sin + 0.000719 * twice.cos() + 0.000077 * twice.sin()
    }

    /// Azimuth, clockwise from north, and altitude of the sun in radians, including refraction by the atmosphere.
    /// `None` if the position cannot be computed.
    pub fn sun(&self, place: Place) -> Option<(f64, f64)> {
        let midnight = JulianDate::from_utc(self.year, self.month, self.day, 0, 0, 0.0, 0.0).ok()?;
        let delta_t = solar_positioning::delta_t::estimate_from_date(self.year, self.month).ok()?;
        let days = (self.hours - self.offset) / 24.0;
        let time = JulianDate::new(midnight.julian_date() + days, delta_t).ok()?;
        let location = Location { latitude: place.latitude, longitude: place.longitude };
        let air = Some(RefractionCorrection::standard());
        let sun = SolarPositions::new().at_from_julian(time, location, 0.0, air).ok()?;
        Some((sun.azimuth().to_radians(), sun.elevation_angle().to_radians()))
    }
}

fn is_leap(year: i32) -> bool {
    year % 4 == 0 && (year % 100 != 0 || year % 400 == 0)
}

impl FromStr for Place {
    type Err = String;

    /// Reads `LATITUDE,LONGITUDE` in degrees.
    fn from_str(text: &str) -> Result<Place, String> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[latitude, longitude])
                if (-90.0..=90.0).contains(&latitude) && (-180.0..=180.0).contains(&longitude) =>
            {
                Ok(Place { latitude, longitude })
            }
            _ => Err("expected LATITUDE,LONGITUDE in degrees, north and east positive".into()),
        }
    }
}

impl FromStr for Moment {
    type Err = String;

    /// Reads `YYYY-MM-DDTHH:MM[:SS]` with `Z` or an offset like `+02:00`.
    fn from_str(text: &str) -> Result<Moment, String> {
        let wanted = || {
            String::from(
                "expected a date, a time and its offset from UTC, as in 2026-06-21T12:00+02:00; Z stands for no offset",
            )
        };
        let read = || -> Option<Moment> {
            let (date, rest) = text.split_once(['T', ' '])?;
            let mut date = date.split('-');
            let (year, month, day) = (date.next()?, date.next()?, date.next()?);
            let whole = |word: &str, digits: usize| {
                let good = word.len() == digits && word.bytes().all(|b| b.is_ascii_digit());
                good.then(|| word.parse::<u32>().ok()).flatten()
            };
            let (clock, offset) = match rest.find(['Z', '+', '-'])? {
                at if &rest[at..] == "Z" => (&rest[..at], 0.0),
                at => {
                    let sign = if rest.as_bytes()[at] == b'-' { -1.0 } else { 1.0 };
                    let (hours, minutes) = rest[at + 1..].split_once(':')?;
                    let minutes = f64::from(whole(minutes, 2).filter(|m| *m < 60)?);
                    (&rest[..at], sign * (f64::from(whole(hours, 2)?) + minutes / 60.0))
                }
            };
            let mut words = clock.split(':');
            let (hours, minutes) = (whole(words.next()?, 2)?, whole(words.next()?, 2)?);
            let seconds = words.next().map_or(Some(0), |word| whole(word, 2))?;
            if words.next().is_some() || date.next().is_some() || hours > 23 || minutes > 59 || seconds > 59 {
                return None;
            }
            let hours = f64::from(hours) + f64::from(minutes) / 60.0 + f64::from(seconds) / 3600.0;
            Moment::new(whole(year, 4)? as i32, whole(month, 2)?, whole(day, 2)?, hours, offset)
        };
        read().ok_or_else(wanted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sun(place: &str, at: &str) -> [f64; 2] {
        let (azimuth, altitude) = at.parse::<Moment>().unwrap().sun(place.parse().unwrap()).unwrap();
        [azimuth.to_degrees(), altitude.to_degrees()]
    }

    /// At the solstice, the noon sun of Munich has an altitude of 90 - 48.1 + 23.44 degrees, in the south. In Sydney,
    /// it is in the north.
    #[test]
    fn the_noon_sun() {
        // Solar noon in hours of UTC is 12, minus the longitude over 15, corrected by the equation of time, -1.8
        // minutes.
        let [azimuth, altitude] = sun("48.1,11.6", "2026-06-21T13:15:30+02:00");
        assert!((azimuth - 180.0).abs() < 1.0, "{azimuth}");
        assert!((altitude - (90.0 - 48.1 + 23.436)).abs() < 0.02, "{altitude}");
        let [azimuth, altitude] = sun("-33.87,151.21", "2026-12-21T01:53:00Z");
        assert!(!(5.0..355.0).contains(&azimuth), "{azimuth}");
        assert!((altitude - (90.0 - 33.87 + 23.436)).abs() < 0.05, "{altitude}");
    }

    /// The example in the algorithm's report: zenith angle 50.11162 and azimuth 194.34024 degrees, at 1830 m and 820
    /// mbar.
    #[test]
    fn the_example_of_the_algorithm() {
        let [azimuth, altitude] = sun("39.742476,-105.1786", "2003-10-17T12:30:30-07:00");
        assert!((azimuth - 194.34).abs() < 0.01, "{azimuth}");
        assert!((altitude - (90.0 - 50.112)).abs() < 0.01, "{altitude}");
    }

    /// The sun rises in the east, and longitudes are positive there. An hour later in UTC, the sun has the same
    /// position 15 degrees further west.
    #[test]
    fn longitudes_are_positive_in_the_east() {
        let [morning, _] = sun("0,0", "2026-03-20T07:00Z");
        assert!((80.0..100.0).contains(&morning), "{morning}");
        let here = sun("50,15", "2026-04-01T09:00Z");
        let there = sun("50,0", "2026-04-01T10:00Z");
        assert!((here[0] - there[0]).abs() < 0.1 && (here[1] - there[1]).abs() < 0.1, "{here:?} {there:?}");
    }

    #[test]
    fn moments_are_read_whole_or_not_at_all() {
        let moment: Moment = "2024-03-01T06:30:36+05:30".parse().unwrap();
        assert_eq!(moment.day_of_year(), 61);
        assert!((moment.hours - 6.51).abs() < 1e-12 && moment.offset == 5.5);
        assert!("2026-06-21T12:00Z".parse::<Moment>().is_ok());
        for wrong in [
            "",
            "2026-06-21",
            "2026-06-21T12:00",
            "2026-02-29T12:00Z",
            "2026-06-31T12:00Z",
            "2026-13-01T12:00Z",
            "2026-06-21T25:00Z",
            "2026-06-21T12:60Z",
            "2026-6-21T12:00Z",
            "2026-06-21T12:00+2",
            "noon",
            "2026-06-21T12:00:00:00Z",
            "2026-06-21T12:00Zulu",
            "1600-06-21T12:00Z",
        ] {
            assert!(wrong.parse::<Moment>().is_err(), "{wrong}");
        }
        for wrong in ["", "48", "91,0", "0,181", "a,b", "1,2,3", "nan,0"] {
            assert!(wrong.parse::<Place>().is_err(), "{wrong}");
        }
    }

    /// Sunlight is about 3.4 % stronger than the mean at the beginning of January, and weaker in July.
    #[test]
    fn the_distance_of_the_sun() {
        let of = |date: &str| format!("{date}T12:00Z").parse::<Moment>().unwrap().eccentricity();
        assert!((of("2026-01-03") - 1.035).abs() < 1e-3 && (of("2026-07-04") - 0.967).abs() < 1e-3);
    }
}
