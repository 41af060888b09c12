//! Products of form factors with radiosity.

use rayon::prelude::*;

use super::{FormFactors, Matrix, Real, SHORT, Stored, row};

impl FormFactors {
    /// Σ_j F_ij of every row i.
    pub fn row_sums(&self) -> Vec<f64> {
        self.irradiance(&vec![1.0; self.len()], 1)
    }

    /// Σ_i A_i F_ij of every column j: the power that other patches receive for a radiosity of one of patch j.
    pub fn column_sums(&self) -> Vec<f64> {
        let weight = |i: usize| self.areas[i] * self.left[i];
        let mut sums = vec![[0.0]; self.len()];
        match &*self.stored {
            Stored::Symmetric(matrix) => {
                let weights: Vec<[f64; 1]> = (0..self.len()).map(|i| [weight(i)]).collect();
                matrix.add_product(&weights, &mut sums);
            }
            Stored::Rows(matrix) => {
                for (&s, (i, j)) in matrix {
                    sums[j as usize][0] += weight(i as usize) * f64::from(s);
                }
            }
        }
        sums.iter().zip(&self.right).map(|([sum], right)| sum * right).collect()
    }

    /// Irradiance E_i = Σ_j F_ij B_j of every patch, from `channels` (1 or 3) interleaved values of radiosity.
    ///
    /// # Panics
    /// When `radiosity` does not have `channels` values a patch.
    pub fn irradiance(&self, radiosity: &[f64], channels: usize) -> Vec<f64> {
        let mut irradiance = vec![0.0; radiosity.len()];
        match channels {
            1 => self.irradiance_into::<f64, 1>(radiosity, &mut irradiance),
            3 => self.irradiance_into::<f64, 3>(radiosity, &mut irradiance),
            _ => panic!("{channels} channels: must be 1 or 3"),
        }
        irradiance
    }

    /// Like [`FormFactors::irradiance`], for `C` channels in single or double precision, into an existing vector.
    pub(crate) fn irradiance_into<T: Real, const C: usize>(&self, radiosity: &[T], irradiance: &mut [T]) {
        assert_eq!(radiosity.len(), C * self.len(), "radiosity needs one value a patch and channel");
        let mut scaled = radiosity.as_chunks::<C>().0.to_vec();
        scaled.par_iter_mut().zip(&self.right).with_min_len(SHORT).for_each(|(b, right)| {
            b.iter_mut().for_each(|b| *b = *b * T::of(*right));
        });
        let out = irradiance.as_chunks_mut::<C>().0;
        match &*self.stored {
            Stored::Symmetric(matrix) => {
                out.fill([T::of(0.0); C]);
                matrix.add_product(&scaled, out);
            }
            Stored::Rows(matrix) => gather(matrix, &scaled, out),
        }
        out.par_iter_mut().zip(&self.left).with_min_len(SHORT).for_each(|(e, left)| {
            e.iter_mut().for_each(|e| *e = *e * T::of(*left));
        });
    }

    /// Adds Σ_j s_ij z_j to every `out_i`, where F_ij = left_i s_ij right_j. Only for pooled form factors, whose s is
    /// symmetric.
    pub(crate) fn add_exchanged<T: Real, const W: usize>(&self, z: &[[T; W]], out: &mut [[T; W]]) {
        match &*self.stored {
            Stored::Symmetric(matrix) => matrix.add_product(z, out),
            Stored::Rows(_) => unreachable!("one-way form factors are not symmetric"),
        }
    }
}

/// out_i = Σ_j s_ij z_j for `C` channels.
///
/// The product of sprs is serial. This one runs in parallel over rows and sums each row in order, so that the result
/// does not depend on the number of threads.
fn gather<T: Real, const C: usize>(matrix: &Matrix, z: &[[T; C]], out: &mut [[T; C]]) {
    assert_eq!((matrix.cols(), matrix.rows()), (z.len(), out.len()), "sizes disagree");
    out.par_iter_mut().enumerate().with_min_len(128).for_each(|(i, out)| {
        let (columns, values) = row(matrix, i);
        *out = [T::of(0.0); C];
        for (&j, &s) in columns.iter().zip(values) {
            for c in 0..C {
                out[c] += T::from(s) * z[j as usize][c];
            }
        }
    });
}
