//! Models of reflection by name, as in `--model floor=ward:0.2,0.1,0.1`.

use radiosity::{
    Scene,
    scene::{Distribution, Fresnel, Shadowing, Specular},
};

/// A material and its specular part.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    pub material: String,
    specular: Specular,
}

const FORMS: &str = "mirror:KS, phong:KS,N, blinn-phong:KS,N, ward:KS,AX,AY, beckmann:KS,ALPHA, ggx:KS,ALPHA, \
    schlick:KS,ALPHA, conductor:ETA,KAPPA,ALPHA or metallic-roughness:METALLIC,ROUGHNESS";

/// Reads `MATERIAL=MODEL`.
pub fn model(text: &str) -> Result<Model, String> {
    let form = || format!("expected MATERIAL=MODEL, where MODEL is {FORMS}");
    let (material, model) = text.rsplit_once('=').ok_or_else(form)?;
    let (name, numbers) = model.split_once(':').ok_or_else(form)?;
    let numbers: Option<Vec<f64>> = numbers.split(',').map(|word| word.trim().parse().ok()).collect();
    let numbers = numbers.ok_or_else(form)?;
    let facets = |distribution, alpha, fresnel| {
        let shadowing = Shadowing::HeightCorrelated;
        Specular::Microfacet { distribution, alpha: [alpha; 2], fresnel, shadowing }
    };
    let constant = |ks| Fresnel::Constant([ks; 3]);
    let specular = match (name, &numbers[..]) {
        ("mirror", &[ks]) => Specular::Mirror(constant(ks)),
        ("phong", &[ks, exponent]) => Specular::Phong { reflectance: [ks; 3], exponent },
        ("blinn-phong", &[ks, exponent]) => Specular::BlinnPhong { reflectance: [ks; 3], exponent },
        ("ward", &[ks, ax, ay]) => Specular::Ward { reflectance: [ks; 3], alpha: [ax, ay] },
        ("beckmann", &[ks, alpha]) => facets(Distribution::Beckmann, alpha, constant(ks)),
        ("ggx", &[ks, alpha]) => facets(Distribution::Ggx, alpha, constant(ks)),
        ("schlick", &[ks, alpha]) => facets(Distribution::Ggx, alpha, Fresnel::Schlick([ks; 3])),
        ("conductor", &[eta, kappa, alpha]) => {
            facets(Distribution::Ggx, alpha, Fresnel::Conductor { eta: [eta; 3], kappa: [kappa; 3] })
        }
        ("metallic-roughness", &[metallic, roughness]) => {
            Specular::MetallicRoughness { metallic, roughness, anisotropy: 0.0 }
        }
        _ => return Err(form()),
    };
    specular.check()?;
    Ok(Model { material: material.into(), specular })
}

impl Model {
    /// Gives the specular part to all materials of this name, and returns their number.
    pub fn apply(&self, scene: &mut Scene) -> usize {
        let named = scene.materials.iter_mut().filter(|m| m.name == self.material);
        named.map(|m| m.specular = Some(Box::new(self.specular.clone()))).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_are_read_and_checked() {
        let ward = model("my = floor=ward:0.2,0.1,0.3").unwrap();
        assert_eq!(ward.material, "my = floor");
        assert_eq!(ward.specular, Specular::Ward { reflectance: [0.2; 3], alpha: [0.1, 0.3] });
        for good in [
            "a=mirror:1",
            "a=phong:0.5,0",
            "a=blinn-phong:0.5,100",
            "a=beckmann:0,0.5",
            "a=ggx:1,1",
            "a=schlick:0.04,0.2",
            "a=conductor:0.2,3.9,0.1",
            "a=metallic-roughness:1,0",
        ] {
            assert!(model(good).is_ok(), "{good}");
        }
        for (wrong, why) in [
            ("mirror:1", "MATERIAL=MODEL"),
            ("a=mirror", "MATERIAL=MODEL"),
            ("a=mirror:1,2", "mirror:KS"),
            ("a=glass:1", "ggx:KS,ALPHA"),
            ("a=mirror:1.5", "reflectance 1.5 is outside 0..1"),
            ("a=mirror:nan", "outside"),
            ("a=phong:0.5,-1", "exponent -1"),
            ("a=ward:0.5,0,0.1", "roughness 0"),
            ("a=ggx:0.5,2", "roughness 2"),
            ("a=conductor:0,1,0.1", "index of refraction"),
        ] {
            assert!(model(wrong).unwrap_err().contains(why), "{wrong}: {:?}", model(wrong));
        }
    }
}
