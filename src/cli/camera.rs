//! The camera of a picture.

use clap::Args;
use glam::DVec3;
use radiosity::{
    Error, Result, Scene,
    monte_carlo::{Camera, PathOptions, PathTracer},
    trace::Tracer,
};

use super::{options::point, watch::Watch};

/// The camera. Options that are not given are chosen so that the picture frames the scene.
#[derive(Args)]
pub struct CameraArgs {
    /// Width of the picture
    #[arg(long, value_name = "PIXELS", default_value_t = 640)]
    width: usize,
    /// Height of the picture
    #[arg(long, value_name = "PIXELS", default_value_t = 480)]
    height: usize,
    /// Position of the camera, in the unit of the scene [default: frames the scene]
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    eye: Option<DVec3>,
    /// Point in the middle of the picture [default: frames the scene]
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    look_at: Option<DVec3>,
    /// Vertical angle of view in degrees [default: frames the scene]
    #[arg(long, value_name = "DEG")]
    fov: Option<f64>,
}

impl CameraArgs {
    /// The camera of the options. `up` gives the upward direction of the picture for a direction of view. Missing
    /// values come from the camera that frames the scene.
    pub fn camera(
        &self,
        up: impl Fn(DVec3) -> Option<DVec3>,
        scene: &Scene,
        tracer: &Tracer,
    ) -> Result<Camera> {
        let framed = Camera::frame(scene, tracer, self.width, self.height)?;
        let (eye, look_at) = (self.eye.unwrap_or(framed.eye()), self.look_at.unwrap_or(framed.look_at()));
        Camera::new(
            eye,
            look_at,
            up(look_at - eye).unwrap_or(framed.up()),
            self.fov.unwrap_or(framed.fov()),
            self.width,
            self.height,
        )
    }
}

/// Refuses a camera that sees nothing, or only backs without light. Warns if it sees only backs.
pub fn check(
    args: &CameraArgs,
    camera: &Camera,
    scene: &Scene,
    tracer: &Tracer,
    watch: &Watch,
) -> Result<()> {
    let hint = match args.eye.is_some() || args.look_at.is_some() {
        true => "give another --eye and --look-at, or leave both out to frame the scene",
        false => "give --eye and --look-at",
    };
    look(camera, scene, tracer, watch).map_err(|error| error.with_hint(hint))
}

fn look(camera: &Camera, scene: &Scene, tracer: &Tracer, watch: &Watch) -> Result<()> {
    let Some(warning) = camera.check(tracer)? else { return Ok(()) };
    if !camera.sees_light(&PathTracer::new(scene, tracer, PathOptions::default())) {
        return Err(Error::Usage {
            message: format!("{warning}; no light reaches the visible surfaces"),
            hint: None,
        });
    }
    watch.warn(&warning);
    Ok(())
}
