//! Weather files in EPW (EnergyPlus Weather): a comma-separated table of the hours of a year after eight lines of
//! headers.
//!
//! The label of an hour is its end: hour 1 is from midnight to one. So the sun of an hour is its position half an hour
//! before the label. In the hours of sunrise and sunset, it is the position in the middle of the time that the sun is
//! up. The direct light of an hour comes from four positions, because the sun moves by 15 degrees in that time.

use std::path::Path;

use super::{Moment, Place};
use crate::{Error, Result};

/// Number of header lines before the table.
const HEADERS: usize = 8;
/// Columns of the direct normal and the diffuse horizontal irradiance, counted from 0.
const DIRECT: usize = 14;
const DIFFUSE: usize = 15;
/// Column of the dew point, and the value used if it is missing, in °C.
const DEW_POINT: usize = 7;
const USUAL_DEW_POINT: f64 = 10.0;
/// Largest number of hours in a file.
const MOST_HOURS: usize = 100_000;
/// Irradiances from this value on mean that the value is missing. So do negative ones.
const MISSING: f64 = 9999.0;
/// More direct normal irradiance than this in an hour without sun is a contradiction, W/m² (`gendaymtx` of RADIANCE warns
/// from the same value).
const NIGHT: f64 = 20.0;
/// Positions of the sun in an hour for its direct light. Beside a window frame the light comes and goes within the hour. In
/// a room with a window in Seville, the mean illuminance of a year was wrong by up to 5.6 % at single points with one
/// position, 2.5 % with two, 0.7 % with four and 0.6 % with six, compared with every minute.
pub const POSITIONS: usize = 4;
/// Number of moments in an hour for which the program computes whether the sun is up.
const PARTS: usize = 60;

/// An hour of a weather file.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Hour {
    /// Month, day of the month, and the label of the hour, from 1 to 24.
    pub label: [u32; 3],
    /// Direct normal irradiance, W/m²; 0 if it is missing.
    pub direct: f64,
    /// Diffuse horizontal irradiance, W/m²; 0 if it is missing.
    pub diffuse: f64,
    /// Whether the file lacks one of the two, and the sun is up.
    pub is_missing: bool,
    /// Line of the file, from 1.
    pub line: usize,
    /// Dew point, °C.
    pub dew_point: f64,
    /// Azimuth and altitude of the sun in radians, if it is up in any part of the hour.
    pub sun: Option<(f64, f64)>,
    /// Azimuth of the sun in the middle of the hour in radians, also when it is down.
    pub azimuth: f64,
    /// Azimuth and altitude of the sun in the middle of each part of the hour, where it is up.
    pub positions: [Option<(f64, f64)>; POSITIONS],
    /// The factor of the solar constant on that day.
    pub eccentricity: f64,
}

impl Hour {
    /// The label in words.
    fn name(&self) -> String {
        let [month, day, label] = self.label;
        format!("hour {label} of {month}/{day}")
    }

    /// Whether this hour comes after another one. After the last hour of a year comes its first. A year may have a leap
    /// day, which files of a typical year have not.
    fn follows(&self, before: &Hour) -> bool {
        let [month, day, label] = before.label;
        let is_day = |year, day| Moment::new(year, month, day, 0.0, 0.0).is_some();
        match label {
            ..24 => self.label == [month, day, label + 1],
            _ => [2000, 2001].into_iter().any(|year| {
                let next = if is_day(year, day + 1) { [month, day + 1, 1] } else { [month % 12 + 1, 1, 1] };
                self.label == next
            }),
        }
    }
}

/// The weather of a place.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Weather {
    /// The place.
    pub place: Place,
    /// Hours that local time is ahead of UTC.
    pub offset: f64,
    /// The hours, in the order of the file.
    pub hours: Vec<Hour>,
}

impl Weather {
    /// Warnings: irradiance is missing while the sun is up, direct irradiance is there while it is down, or hours do not
    /// follow each other.
    pub fn warnings(&self, path: &Path) -> Vec<String> {
        let day = self.hours.iter().filter(|hour| hour.sun.is_some()).count();
        let missing = self.counted(|hour| hour.is_missing).map(|(count, line)| {
            format!(
                "{}:{line}: irradiance is missing in {count} of the {day} hours with the sun up: illuminance is 0 there, and \
                 means and autonomy leave these hours out",
                path.display(),
            )
        });
        let early = self.counted(|hour| hour.sun.is_none() && hour.direct > NIGHT).map(|(count, line)| {
            format!(
                "{}:{line}: the sun is down in {count} hours with direct irradiance, which is left out: the time zone or the \
                 longitude in line 1 may not be those of the table",
                path.display(),
            )
        });
        let mut jumps = self.hours.windows(2).filter(|two| !two[1].follows(&two[0]));
        let jump = jumps.next().map(|two| {
            let [before, after] = [two[0], two[1]].map(|hour| hour.name());
            let more = match jumps.count() {
                0 => String::new(),
                more => format!(", and in {more} more places"),
            };
            format!(
                "{}:{}: {after} follows {before}{more}: if hours are missing or repeated, means and autonomy are not those of \
                 the year",
                path.display(),
                two[1].line,
            )
        });
        missing.into_iter().chain(early).chain(jump).collect()
    }

    /// The number of hours with a property, if there are any, and the line of the first.
    fn counted(&self, of: impl Fn(&Hour) -> bool) -> Option<(usize, usize)> {
        let mut hours = self.hours.iter().filter(|hour| of(hour));
        hours.next().map(|first| (1 + hours.count(), first.line))
    }

    /// Reads an EPW file.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read. [`Error::Input`], with the line, when its contents cannot be used.
    pub fn load(path: &Path) -> Result<Weather> {
        let bytes = std::fs::read(path).map_err(|source| Error::io(path, source))?;
        parse(&String::from_utf8_lossy(&bytes))
            .map_err(|(line, message)| Error::input(path, Some(line), message))
    }
}

type Wrong = (usize, String);

fn parse(text: &str) -> std::result::Result<Weather, Wrong> {
    let lines: Vec<&str> = text.trim_start_matches('\u{feff}').lines().collect();
    let header: Vec<&str> = lines.first().map_or(Vec::new(), |line| line.split(',').map(str::trim).collect());
    if header.first().is_none_or(|word| !word.eq_ignore_ascii_case("LOCATION")) {
        return Err((1, "not an EPW file: it does not begin with LOCATION".into()));
    }
    let figure = |column: usize, range: std::ops::RangeInclusive<f64>, what: &str| {
        let value = header.get(column).and_then(|word| word.parse().ok()).filter(|x| range.contains(x));
        value.ok_or_else(|| (1, format!("{what} is missing, not a number, or out of range")))
    };
    let place = Place {
        latitude: figure(6, -90.0..=90.0, "the latitude, column 7,")?,
        longitude: figure(7, -180.0..=180.0, "the longitude, column 8,")?,
    };
    let offset = figure(8, -14.0..=14.0, "the time zone, column 9,")?;
    let last_day = last_day(lines.get(HEADERS - 1)).map_err(|message| (HEADERS, message))?;
    let mut hours = Vec::new();
    for (k, line) in lines.iter().enumerate().skip(HEADERS) {
        if line.trim().is_empty() {
            continue;
        }
        if hours.len() == MOST_HOURS {
            return Err((k + 1, format!("more than {MOST_HOURS} hours")));
        }
        let hour = hour(line, place, offset).map_err(|message| (k + 1, message))?;
        hours.push(Hour { line: k + 1, ..hour });
    }
    if hours.is_empty() {
        return Err((lines.len(), "no hours after the eight lines of headers".into()));
    }
    let last = &hours[hours.len() - 1];
    if let Some([month, day]) = last_day.filter(|&[month, day]| last.label != [month, day, 24]) {
        return Err((
            last.line,
            format!(
                "the table ends with {}, but line {HEADERS} says that it ends with hour 24 of {month}/{day}: is the file cut off? \
                 If not, correct line {HEADERS}",
                last.name()
            ),
        ));
    }
    Ok(Weather { place, offset, hours })
}

/// Checks that the table has one record an hour, where its header tells the number. Returns month and day of the last
/// record, where the header tells them.
fn last_day(line: Option<&&str>) -> std::result::Result<Option<[u32; 2]>, String> {
    let words: Vec<&str> = line.map_or(Vec::new(), |line| line.split(',').map(str::trim).collect());
    match words[..] {
        [name, _, records, ..] if name.eq_ignore_ascii_case("DATA PERIODS") && records != "1" => {
            Err(format!("the table has `{records}` records an hour: only hourly files can be used"))
        }
        // Month and day, and a year where the table has the years of measurements. After this come other periods.
        [name, periods, .., last] if name.eq_ignore_ascii_case("DATA PERIODS") => {
            let last = if periods == "1" { words.get(6).copied().unwrap_or(last) } else { last };
            let numbers: Vec<u32> = last.split('/').map_while(|word| word.trim().parse().ok()).collect();
            Ok(match numbers[..] {
                [month @ 1..=12, day @ 1..=31] | [month @ 1..=12, day @ 1..=31, _] => Some([month, day]),
                _ => None,
            })
        }
        _ => Ok(None),
    }
}

fn hour(line: &str, place: Place, offset: f64) -> std::result::Result<Hour, String> {
    let words: Vec<&str> = line.split(',').map(str::trim).collect();
    let whole = |column: usize, what: &str| {
        let value = words.get(column).and_then(|word| word.parse::<u32>().ok());
        value.ok_or_else(|| format!("column {}, {what}, is not a number", column + 1))
    };
    let [year, month, day, label] =
        [whole(0, "the year")?, whole(1, "the month")?, whole(2, "the day")?, whole(3, "the hour")?];
    let light = |column: usize, what: &str| {
        let value = words.get(column).and_then(|word| word.parse::<f64>().ok());
        let value = value.ok_or_else(|| format!("column {}, {what}, is not a number", column + 1))?;
        Ok::<Option<f64>, String>(Some(value).filter(|value| (0.0..MISSING).contains(value)))
    };
    let (direct, diffuse) = (
        light(DIRECT, "the direct normal irradiance")?,
        light(DIFFUSE, "the diffuse horizontal irradiance")?,
    );
    let dew_point = words.get(DEW_POINT).and_then(|word| word.parse().ok());
    let dew_point = dew_point.filter(|t| (-70.0..70.0).contains(t)).unwrap_or(USUAL_DEW_POINT);
    if !(1..=24).contains(&label) {
        return Err(format!("column 4: the hour {label} is not from 1 to 24"));
    }
    // A typical year consists of months of several years. Each hour uses the year in its line, if that year has the
    // day.
    let of_file = i32::try_from(year).ok().filter(|year| (1900..=2200).contains(year)).unwrap_or(2001);
    let at = |hours: f64| {
        let of = |year: i32| Moment::new(year, month, day, hours, offset);
        of(of_file).or_else(|| of(2000))
    };
    let moment =
        at(f64::from(label) - 0.5).ok_or_else(|| format!("there is no day {day} in month {month}"))?;
    // Whether the sun is up at a part of the hour, from 0 to 1.
    let is_up = |part: &f64| {
        let moment = at(f64::from(label) - 1.0 + part);
        moment.and_then(|moment| moment.sun(place)).is_some_and(|(_, altitude)| altitude > 0.0)
    };
    let centre = |k: usize| (k as f64 + 0.5) / PARTS as f64;
    let whole_hour = is_up(&0.0) && is_up(&1.0) && is_up(&0.5);
    let middle = if whole_hour {
        Some(0.5)
    } else if is_up(&0.0) || is_up(&0.5) || is_up(&1.0) {
        let up: Vec<f64> = (0..PARTS).map(centre).filter(is_up).collect();
        (!up.is_empty()).then(|| up.iter().sum::<f64>() / up.len() as f64)
    } else {
        None
    };
    let sun_at = |part: f64| {
        let sun = at(f64::from(label) - 1.0 + part).and_then(|moment| moment.sun(place));
        sun.filter(|&(_, altitude)| altitude > 0.0)
    };
    let sun = middle.and_then(sun_at);
    let positions = match sun {
        Some(_) => std::array::from_fn(|k| sun_at((k as f64 + 0.5) / POSITIONS as f64)),
        None => [None; POSITIONS],
    };
    Ok(Hour {
        label: [month, day, label],
        direct: direct.unwrap_or(0.0),
        diffuse: diffuse.unwrap_or(0.0),
        is_missing: sun.is_some() && (direct.is_none() || diffuse.is_none()),
        line: 0,
        dew_point,
        sun,
        azimuth: moment.sun(place).map_or(0.0, |(azimuth, _)| azimuth),
        positions,
        eccentricity: moment.eccentricity(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(hours: &[(u32, u32, u32, &str, &str)]) -> String {
        let mut text = String::from("LOCATION,Munich,-,DEU,made,108660,48.1,11.6,1.0,520\n");
        text += &"HEADER,0\n".repeat(7);
        for (month, day, hour, direct, diffuse) in hours {
            text += &format!(
                "2026,{month},{day},{hour},60,?9,20,10,50,95000,0,0,300,500,{direct},{diffuse},0,0\n"
            );
        }
        text
    }

    /// Hour 13 is from noon to one. Its sun is the sun at half past twelve, local standard time.
    #[test]
    fn hours_end_at_their_label() {
        let weather = parse(&file(&[(6, 21, 13, "700", "120")])).unwrap();
        let hour = weather.hours[0];
        assert_eq!((hour.direct, hour.diffuse, hour.label), (700.0, 120.0, [6, 21, 13]));
        let noon: Moment = "2026-06-21T12:30+01:00".parse().unwrap();
        assert_eq!(hour.sun, noon.sun(weather.place));
        // Solar noon is at 12:15 in Munich's standard time. The sun of hour 12 is east of south, the sun of hour 13
        // west of it.
        let [before, after] = [12, 13]
            .map(|h| parse(&file(&[(6, 21, h, "1", "1")])).unwrap().hours[0].sun.unwrap().0.to_degrees());
        assert!(before < 180.0 && after > 180.0, "{before} {after}");
    }

    /// The sun rises at 4:15 in Munich at midsummer. The hour from 4 to 5 has the sun of 4:37, which is above the
    /// horizon.
    #[test]
    fn the_hour_of_sunrise_has_the_risen_sun() {
        let weather = parse(&file(&[(6, 21, 5, "30", "20"), (6, 21, 4, "0", "0")])).unwrap();
        let (_, altitude) = weather.hours[0].sun.unwrap();
        let later: Moment = "2026-06-21T04:37:30+01:00".parse().unwrap();
        let (_, wanted) = later.sun(weather.place).unwrap();
        assert!((altitude - wanted).abs() < 0.4f64.to_radians() && altitude > 0.0, "{altitude} {wanted}");
        assert_eq!(weather.hours[1].sun, None);
    }

    #[test]
    fn missing_light_is_counted_and_wrong_lines_are_named() {
        let light = [("9999", "9"), ("5", "-9999"), ("5", "9"), ("nan", "9")];
        let day: [_; 4] = std::array::from_fn(|k| (1, 1, 10 + k as u32, light[k].0, light[k].1));
        let night = [14, 15, 16, 17, 18].map(|hour| (1, 1, hour, "9999", "9999"));
        let weather = parse(&file(&[&day[..], &night].concat())).unwrap();
        let missing: Vec<bool> = weather.hours.iter().map(|hour| hour.is_missing).collect();
        assert_eq!(missing, [true, true, false, true, true, true, true, true, false]);
        assert_eq!((weather.hours[0].direct, weather.hours[1].diffuse), (0.0, 0.0));
        let warnings = weather.warnings(Path::new("a.epw"));
        assert!(
            warnings[0].starts_with("a.epw:9: irradiance is missing in 7 of the 8 hours"),
            "{warnings:?}"
        );
        assert_eq!(warnings.len(), 1);
        assert!(
            parse(&file(&[(1, 1, 18, "9999", "0"), (1, 1, 19, "0", "0")]))
                .unwrap()
                .warnings(Path::new(""))
                .is_empty()
        );
        // At three in the night, direct sunlight is a contradiction.
        let night = parse(&file(&[day[2], (1, 1, 3, "100", "20"), (1, 1, 4, "19", "2")])).unwrap();
        let warnings = night.warnings(Path::new("a.epw"));
        assert!(warnings[0].starts_with("a.epw:10: the sun is down in 1 hours"), "{warnings:?}");
        for (text, line) in [
            (String::new(), 1),
            ("LOCATION,x\n".into(), 1),
            (file(&[]), 8),
            (file(&[(1, 1, 1, "1", "1")]).replacen("HEADER,0\n2026", "DATA PERIODS,1,4,x\n2026", 1), 8),
            (file(&[(13, 1, 1, "1", "1")]), 9),
            (file(&[(2, 30, 1, "1", "1")]), 9),
            (file(&[(1, 1, 25, "1", "1")]), 9),
            (file(&[(1, 1, 1, "x", "1")]), 9),
            (file(&[(1, 1, 1, "1", "1"), (1, 1, 2, "1", "")]), 10),
        ] {
            assert_eq!(parse(&text).unwrap_err().0, line, "{text}");
        }
        assert!(parse(&file(&[(2, 29, 12, "1", "1")])).is_ok());
    }

    /// A file that is cut off is an error. Missing and repeated hours are warned of.
    #[test]
    fn the_table_has_all_hours_of_its_period() {
        let day = |day: u32| (1..=24).map(move |hour| (2, day, hour, "0", "0"));
        let hours: Vec<_> = day(28).chain((1..=24).map(|hour| (3, 1, hour, "0", "0"))).collect();
        let text = |header: &str| file(&hours).replacen("HEADER,0\n2026", &format!("{header}\n2026"), 1);
        for header in [
            "DATA PERIODS,1,1,Data,Sunday, 2/28, 3/ 1",
            "DATA PERIODS,2,1,A,Sunday,2/28,2/28,B,Sunday,3/1,3/1/2026",
        ] {
            assert!(parse(&text(header)).unwrap().warnings(Path::new("")).is_empty());
        }
        let year = text("DATA PERIODS,1,1,Data,Sunday,1/1,12/31");
        let (line, message) = parse(&year).unwrap_err();
        assert!(line == 56 && message.contains("hour 24 of 3/1"), "{line}: {message}");
        let cut = text("DATA PERIODS,1,1,Data,Sunday,2/28,3/1");
        let cut = &cut[..cut.trim_end().rfind('\n').unwrap()];
        assert_eq!(parse(cut).unwrap_err().0, 55);
        let mut gap = hours.clone();
        gap.remove(30);
        gap.insert(5, gap[5]);
        let warnings = parse(&file(&gap)).unwrap().warnings(Path::new("a.epw"));
        assert!(
            warnings[0].starts_with("a.epw:15: hour 6 of 2/28 follows hour 6 of 2/28, and in 1 more places"),
            "{warnings:?}"
        );
    }
}
