use datasets_spec::{record::EditRow, *};
use rand::RngExt;
use std::time::Instant;
struct Fake;
impl eval::score::MotionEncoder for Fake {
    fn encode(&self, m: &[&Motion]) -> Result<Vec<Vec<f64>>, eval::EncoderError> {
        Ok(m.iter()
            .map(|m| {
                (0..256)
                    .map(|k| m.body_pose()[k % 60][(k * 7) % 63] as f64)
                    .collect()
            })
            .collect())
    }
    fn hash(&self) -> String {
        "ab".into()
    }
    fn recipe(&self) -> String {
        "fake".into()
    }
}
fn main() {
    let mut rng = Seed(1).rng(&["a"]);
    let mut rows = vec![];
    for i in 0..1013 {
        for s in ["source", "target", "a", "b"] {
            let n = 60;
            let bp: Vec<[f32; 63]> = (0..n)
                .map(|_| std::array::from_fn(|_| rng.random_range(-1.0f32..1.0)))
                .collect();
            rows.push(EditRow {
                id: format!("i{i:05}"),
                split: Split::Test,
                system: s.into(),
                checkpoint_hash: "".into(),
                source_id: "".into(),
                target_id: "".into(),
                instruction: "".into(),
                kind: ["semantic", "style"][i % 2].into(),
                seed: 0,
                fps: 20.0,
                n_frames: n,
                transl: vec![[0.0; 3]; n as usize],
                global_orient: vec![[0.0; 3]; n as usize],
                body_pose: bp,
                fit_error_m: None,
            });
        }
    }
    let t = Instant::now();
    let s = eval::score::score(
        &rows,
        &Fake,
        &Skeleton::smplx_neutral(),
        &Default::default(),
        &NoProgress,
    )
    .unwrap();
    println!("{} scores in {:?}", s.len(), t.elapsed());
    println!(
        "{}",
        eval::format::text::render(&eval::table::Table::from_scores(
            &s,
            &Default::default(),
            eval::metric::Metric::PAPER
        ))
    );
}
