//! Embree 3, found at run time if it is installed (Debian: `libembree3-3`), for comparison.
//!
//! Only the functions that the benchmark calls: one scene of triangles in robust mode, closest hits of single rays.

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};

use glam::Vec3A;
use radiosity::trace::Tracer;

// These are part of the C library, or of a library that the standard library links.
unsafe extern "C" {
    fn dlopen(name: *const c_char, flags: c_int) -> *mut c_void;
    fn dlsym(library: *mut c_void, symbol: *const c_char) -> *mut c_void;
}

const NOW: c_int = 2;
const LIBRARY: &CStr = c"libembree3.so.3";
const FLOAT3: c_uint = 0x9003;
const UINT3: c_uint = 0x5003;
const INDEX_BUFFER: c_uint = 0;
const VERTEX_BUFFER: c_uint = 1;
const GEOMETRY_TRIANGLE: c_uint = 0;
const SCENE_ROBUST: c_uint = 1 << 2;
const NOTHING: c_uint = c_uint::MAX;

/// `RTCRayHit` of Embree 3 with one level of instances.
#[repr(C, align(16))]
struct RayHit {
    origin: [f32; 3],
    near: f32,
    direction: [f32; 3],
    time: f32,
    far: f32,
    mask: c_uint,
    id: c_uint,
    flags: c_uint,
    normal: [f32; 3],
    uv: [f32; 2],
    primitive: c_uint,
    geometry: c_uint,
    instance: c_uint,
}

/// `RTCIntersectContext`: zero flags mean incoherent rays, and there is no filter.
#[repr(C)]
struct Context {
    flags: c_uint,
    filter: *const c_void,
    instance: c_uint,
}

type Handle = *mut c_void;
type NewBuffer = unsafe extern "C" fn(Handle, c_uint, c_uint, c_uint, usize, usize) -> *mut c_void;

/// A committed scene, never released: the benchmark ends soon.
pub struct Embree {
    scene: Handle,
    intersect1: unsafe extern "C" fn(Handle, *mut Context, *mut RayHit),
}

// SAFETY: Embree's committed scenes may be intersected from any number of threads.
unsafe impl Sync for Embree {}

impl Embree {
    /// The tracer's triangles in unit space. Returns `None` if Embree is not installed.
    pub fn new(tracer: &Tracer) -> Option<Embree> {
        // SAFETY: the signatures are those of Embree 3's rtcore headers, the handles are used in their order, and both
        // buffers are written within the requested sizes.
        unsafe {
            let library = dlopen(LIBRARY.as_ptr(), NOW);
            if library.is_null() {
                return None;
            }
            macro_rules! function {
                ($name:literal: $type:ty) => {{
                    let symbol = dlsym(library, $name.as_ptr());
                    assert!(!symbol.is_null(), "Embree 3 has {:?}", $name);
                    std::mem::transmute::<*mut c_void, $type>(symbol)
                }};
            }
            let device =
                function!(c"rtcNewDevice": unsafe extern "C" fn(*const c_char) -> Handle)(std::ptr::null());
            let scene = function!(c"rtcNewScene": unsafe extern "C" fn(Handle) -> Handle)(device);
            function!(c"rtcSetSceneFlags": unsafe extern "C" fn(Handle, c_uint))(scene, SCENE_ROBUST);
            let geometry = function!(c"rtcNewGeometry": unsafe extern "C" fn(Handle, c_uint) -> Handle)(
                device,
                GEOMETRY_TRIANGLE,
            );
            let count = tracer.triangles().len();
            let new_buffer = function!(c"rtcSetNewGeometryBuffer": NewBuffer);
            let vertices = new_buffer(geometry, VERTEX_BUFFER, 0, FLOAT3, 12, 3 * count).cast::<[f32; 3]>();
            let indices = new_buffer(geometry, INDEX_BUFFER, 0, UINT3, 12, count).cast::<[u32; 3]>();
            for (t, triangle) in tracer.triangles().iter().enumerate() {
                for k in 0..3 {
                    vertices.add(3 * t + k).write(triangle.corners[k].to_array());
                }
                indices.add(t).write([0, 1, 2].map(|k| 3 * t as u32 + k));
            }
            function!(c"rtcCommitGeometry": unsafe extern "C" fn(Handle))(geometry);
            function!(c"rtcAttachGeometry": unsafe extern "C" fn(Handle, Handle) -> c_uint)(scene, geometry);
            function!(c"rtcCommitScene": unsafe extern "C" fn(Handle))(scene);
            let intersect1 =
                function!(c"rtcIntersect1": unsafe extern "C" fn(Handle, *mut Context, *mut RayHit));
            Some(Embree { scene, intersect1 })
        }
    }

    /// The distance of the closest hit.
    #[inline]
    pub fn closest(&self, origin: Vec3A, direction: Vec3A) -> Option<f32> {
        let mut context = Context { flags: 0, filter: std::ptr::null(), instance: NOTHING };
        let mut ray = RayHit {
            origin: origin.to_array(),
            near: 0.0,
            direction: direction.to_array(),
            time: 0.0,
            far: f32::INFINITY,
            mask: NOTHING,
            id: 0,
            flags: 0,
            normal: [0.0; 3],
            uv: [0.0; 2],
            primitive: NOTHING,
            geometry: NOTHING,
            instance: NOTHING,
        };
        // SAFETY: the scene is committed, ray and context are laid out and aligned as Embree 3 declares them.
        unsafe { (self.intersect1)(self.scene, &mut context, &mut ray) };
        (ray.geometry != NOTHING).then_some(ray.far)
    }
}
