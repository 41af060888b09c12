//! How much work to spend, for those who do not want to choose two numbers.

/// A preset of patches and rays. Memory grows with their product, the error of the rays falls with the root of theirs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quality {
    /// About how many patches to cut the fronts into; never fewer than there are triangles.
    pub patches: usize,
    /// Mean number of rays a patch.
    pub rays: u32,
}

impl Quality {
    /// All of them by their names, the coarsest first.
    pub const PRESETS: [(&str, Quality); 4] = [
        ("draft", Quality::DRAFT),
        ("medium", Quality::MEDIUM),
        ("high", Quality::HIGH),
        ("reference", Quality::REFERENCE),
    ];
    /// 1,000 patches with 64 rays: is the scene as it should be? Below a tenth of a second. On the Cornell box of `meshes/` the
    /// means of about 1,000 patches are 4.4 % RMS off continuous light.
    pub const DRAFT: Quality = Quality { patches: 1_000, rays: 64 };
    /// 8,000 patches with 256 rays: about a second for a room. The same means are 0.58 % off.
    pub const MEDIUM: Quality = Quality { patches: 8_000, rays: 256 };
    /// 32,000 patches with 512 rays.
    pub const HIGH: Quality = Quality { patches: 32_000, rays: 512 };
    /// 100,000 patches with 1,024 rays: what other answers are compared with. A gigabyte or two.
    pub const REFERENCE: Quality = Quality { patches: 100_000, rays: 1_024 };
}

impl Default for Quality {
    /// [`Quality::MEDIUM`].
    fn default() -> Self {
        Quality::MEDIUM
    }
}
