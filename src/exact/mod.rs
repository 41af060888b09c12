//! Exact form factors of unoccluded surfaces, against which the rest of the library is tested.
//!
//! The form factor F12 is the share of the light leaving a Lambertian surface 1 that arrives at surface 2, between 0
//! and 1. The *exchange area* A1 F12 = A2 F21 has the unit of an area and is symmetric; functions of two general
//! surfaces return it. All formulas depend on ratios of lengths only, so any unit of length will do.
//!
//! "Howell C-11" and the like are numbers in J. R. Howell's *A Catalog of Radiation Heat Transfer Configuration
//! Factors*.

mod catalogue;
mod contour;
mod cubature;
mod polygon;
mod rectangle;

pub use catalogue::{
    coaxial_disks, opposed_rectangles, opposed_squares_with_blocker, perpendicular_rectangles,
};
pub(crate) use cubature::nodes;
pub(crate) use polygon::{clip, exchange_area_to, lambert};
pub use polygon::{point_to_polygon, polygon_area, polygon_exchange_area, polygon_form_factor};
pub use rectangle::{Axis, AxisRectangle, box_room_patches, rectangle_form_factors};
