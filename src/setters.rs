//! Structs of options grow with new versions: they are `#[non_exhaustive]`, have defaults, and a method `with_…` for
//! each field.

/// Gives a struct of options a method for each field that returns the same options with another value there.
macro_rules! setters {
    ($options:ident $(<$life:lifetime>)? { $($with:ident($field:ident: $type:ty)),* $(,)? }) => {
        impl $(<$life>)? $options $(<$life>)? {
            $(
                #[doc = concat!("The same with another [`", stringify!($field), "`](field@", stringify!($options), "::", stringify!($field), ").")]
                #[must_use]
                pub fn $with(mut self, $field: $type) -> Self {
                    self.$field = $field;
                    self
                }
            )*
        }
    };
}
