//! Models, diffusion, trainer and editor.
