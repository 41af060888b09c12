//! Light in few bytes: half floats, and three channels of nine bits with a common exponent.

use half::f16;

/// The largest value over the unit: half floats reach 65504, and hold 2²⁹ below it with all eleven digits.
const LARGEST: f64 = 32768.0;

/// A power of two over which all of these values are at most [`LARGEST`]; 1 if none is positive.
pub(crate) fn unit_of(values: impl Iterator<Item = f64>) -> f64 {
    let most = values.filter(|x| x.is_finite()).fold(0.0, f64::max);
    if most > 0.0 { (most / LARGEST).log2().ceil().exp2() } else { 1.0 }
}

/// Values over a unit, rounded to half floats. NaN stays NaN: it means that a value is not known.
pub(crate) fn halves(values: &[f64], unit: f64) -> Vec<u16> {
    let largest = f64::from(f16::MAX);
    values
        .iter()
        .map(|x| {
            let x = x / unit;
            // `clamp` keeps NaN.
            f16::from_f64(x.clamp(-largest, largest)).to_bits()
        })
        .collect()
}

/// A colour as the format RGB9E5 of OpenGL (EXT_texture_shared_exponent).
pub(crate) fn shared_exponent(rgb: [f64; 3]) -> u32 {
    const BITS: i32 = 9;
    const BIAS: i32 = 15;
    let largest = 511.0 / 512.0 * 65536.0;
    // `max` turns NaN into zero.
    let rgb = rgb.map(|x| x.max(0.0).min(largest));
    let most = rgb.into_iter().fold(0.0, f64::max);
    if most == 0.0 {
        return 0;
    }
    let exponent = |most: f64| (most.log2().floor() as i32).max(-BIAS - 1) + 1 + BIAS;
    let scale = |e: i32| f64::from(e - BIAS - BITS).exp2();
    let mut e = exponent(most);
    if (most / scale(e)).round() >= 512.0 {
        e += 1;
    }
    let digits = rgb.map(|x| (x / scale(e)).round() as u32);
    digits[0] | digits[1] << 9 | digits[2] << 18 | (e as u32) << 27
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_keep_eleven_digits_and_what_is_not_known() {
        let values = [0.0, 1e-3, 0.7, 12.0, 4567.0, 1e9];
        let unit = unit_of(values.iter().copied());
        assert_eq!(unit, 32768.0);
        for (x, bits) in values.iter().zip(halves(&values, unit)) {
            let back = f16::from_bits(bits).to_f64() * unit;
            // Half a unit in the last place: 2⁻¹¹ of the value, or 2⁻²⁵ of the unit below the normal range.
            assert!((back - x).abs() <= (x / 2048.0).max(unit / 33_554_432.0), "{x} {back}");
        }
        assert!(f16::from_bits(halves(&[f64::NAN], 1.0)[0]).is_nan());
        assert_eq!(unit_of([0.0, f64::NAN].into_iter()), 1.0);
    }

    #[test]
    fn a_shared_exponent_keeps_nine_digits_of_the_brightest() {
        let back = |bits: u32| {
            let scale = f64::from((bits >> 27) as i32 - 24).exp2();
            [0, 9, 18].map(|shift| f64::from(bits >> shift & 511) * scale)
        };
        for rgb in
            [[1.0, 0.5, 0.25], [0.001, 0.0, 3.0], [511.6, 511.4, 1.0], [0.999, 0.1, 0.0], [40000.0, 7.0, 1.0]]
        {
            let most = rgb.into_iter().fold(0.0, f64::max);
            for (x, back) in rgb.into_iter().zip(back(shared_exponent(rgb))) {
                // The largest has at least 255.5 steps, and half a step is what rounding leaves.
                assert!((x - back).abs() <= most / 511.0, "{rgb:?} {back}");
            }
        }
        assert_eq!(back(shared_exponent([1.0, 0.5, 0.0])), [1.0, 0.5, 0.0]);
        assert_eq!(shared_exponent([0.0, -1.0, f64::NAN]), 0);
    }
}
