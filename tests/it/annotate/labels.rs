//! What people made goes from projects into the dataset and back.

use super::*;

#[test]
fn accepted_answers_feed_the_composer_without_a_step_by_hand() {
    // Of the six pairs that are answered, five are in the test split; the composer uses the sixth.
    let (dir, dataset) = dataset(24);
    let ann = Person::new(&dataset, "ann", "annotator");
    let eve = Person::new(&dataset, "eve", "reviewer");
    wants_one_answer(&dataset);
    let server = Process::start(&dataset, "127.0.0.1:0");
    let url = &server.url;
    let mut me = ann
        .agent
        .post(format!("{url}/api/v1/session"))
        .header("origin", url)
        .header("x-annotate", "1")
        .send(json!({ "token": server.once }).to_string().as_bytes())
        .expect("a server");
    let me = me.body_mut().read_to_vec().expect("a body");
    let me: Value = serde_json::from_slice(&me).expect("JSON");
    assert_eq!(me["user"]["role"], "admin");
    for answer in [masks("testing"), pair()] {
        let kind = answer.kind();
        for number in 0..6 {
            let view = ann.claim(url, kind);
            let key = format!("{kind}-{number}-key").replace('_', "-");
            ann.save(url, &view, &events(&view, &key, &answer));
        }
    }
    for number in 0..12 {
        let next: ReviewNext = eve.post(url, "review/next", &json!({ "queue": "disagreement" }));
        let review = next.review.expect("a review");
        let decision = json!({ "idem_key": format!("review-{number}"), "task": review.task.id,
            "lease_epoch": review.lease.epoch, "decision": "accept", "author": ann.id });
        let _: Value = eve.post(url, "reviews", &decision);
    }
    // The server keeps running while the accepted answers are written.
    let written: Value = annotate(&dataset, &["--json", "export"]).done();
    assert_eq!(written["counts"]["motions_described"], 6);
    dir.run("verify @dataset");
    let masks: Value = dir.json("masks @dataset --accept /dev/null --author x");
    assert_eq!(masks["origins"]["human"], 12);
    let triplets: Value = dir.json("triplets stats @dataset --count 64");
    assert_has(&triplets.to_string(), &["testing", "fine-grained"]);
    dir.run("triplets @dataset --out @triplets --count 16");
}

#[test]
fn masks_that_people_accept_outside_a_project_stay_at_its_export() {
    let (_dir, dataset) = dataset(12);
    answered(&dataset, [masks("testing")]);
    let export = || -> Value { annotate(&dataset, &["--json", "export"]).done() };
    assert_eq!(export()["counts"]["motions_described"], 1);
    let of_people = || -> Vec<MaskRow> {
        let mut rows: Vec<MaskRow> = rows_of(&dataset);
        rows.retain(|row| row.text_origin == "human");
        rows
    };
    let described = of_people();

    // Somebody improves a text without the project.
    let clip = &described[0].motion_id;
    judge_lines(&dataset, "ben", |line| {
        if line["mask"] == described[0].id.as_str() {
            line["text"] = json!("The person is saluting.");
        }
    })
    .expect_code(0);
    let improved = of_people();
    assert_eq!(improved[0].author, "ben");
    let imported: Value = annotate(&dataset, &["--json", "import"]).done();
    assert_eq!(imported["counts"]["conflicts"], 1, "{imported}");
    let exported = export();
    let counts = &exported["counts"];
    assert_eq!(counts["motions_left_to_others"], 1, "{exported}");
    assert_eq!(counts["motions_described"], 0, "{exported}");
    assert_tells(&exported["messages"], &format!("{} by ben", improved[0].id));
    assert_eq!(of_people(), improved);

    // What others reject afterwards stays out.
    judge_lines(&dataset, "cat", |line| {
        if line["motion"] == clip.as_str() {
            line["verdict"] = json!("reject");
        }
    })
    .expect_code(0);
    assert_eq!(of_people(), []);
    let counts = &export()["counts"];
    assert_eq!(counts["masks_rejected_by_others"], described.len());
    assert_eq!(of_people(), []);
}

#[test]
fn what_is_accepted_again_and_rejected_after_the_next_export_stays_out() {
    let (_dir, dataset) = dataset(12);
    let people = answered(&dataset, [masks("testing")]);
    let export = || -> Value { annotate(&dataset, &["--json", "export"]).done() };
    export();
    assert_eq!(take_back(&dataset, people.1), 1);
    let store = open_sqlite(&store_of(&dataset)).expect("a store");
    accept_next(&store, people, "accept-again");
    export();
    let of_people = || {
        let rows = rows_of::<MaskRow>(&dataset).into_iter();
        rows.filter(|row| row.text_origin == "human").count()
    };
    assert_eq!(of_people(), 2);
    judge_lines(&dataset, "cat", |line| {
        if line["text"]
            .as_str()
            .is_some_and(|text| text.contains("testing"))
        {
            line["verdict"] = json!("reject");
        }
    })
    .expect_code(0);
    assert_eq!(export()["counts"]["masks_rejected_by_others"], 2);
    assert_eq!(of_people(), 0);
}

#[test]
fn labels_that_a_project_only_imported_stay_as_the_dataset_has_them() {
    let (dir, dataset) = dataset(12);
    let drafts: Vec<MaskRow> = rows_of(&dataset);
    let of_clip = |row: &MaskRow| {
        let same = drafts
            .iter()
            .filter(|other| other.motion_id == row.motion_id);
        same.count()
    };
    let first = drafts.iter().find(|row| of_clip(row) > 1);
    let first = first.expect("a clip of two masks");
    let second = drafts.iter().find(|row| row.motion_id != first.motion_id);
    let second = second.expect("another clip");
    let judge = |author: &str, texts: &[(&str, &str)]| {
        judge_lines(&dataset, author, |line| {
            for (id, text) in texts {
                if line["mask"] == *id {
                    line["text"] = json!(text);
                    line["verdict"] = json!("accept");
                }
            }
        })
        .expect_code(0);
        rows_of::<MaskRow>(&dataset)
    };
    let other = dir.path("other.sqlite");
    let stores: [&[&str]; 2] = [&[], &["--store", arg(&other)]];
    let export = |store: &[&str]| -> Value {
        annotate(&dataset, &[store, &["--json", "export"]].concat()).done()
    };
    let texts = [
        (first.id.as_str(), "The person is on the floor."),
        (second.id.as_str(), "bring both arms up"),
    ];
    let stated = judge("ben", &texts);
    for store in stores {
        annotate(&dataset, &[store, &["import"]].concat()).expect_code(0);
        assert_eq!(export(store)["counts"]["labels_left_as_they_are"], 2);
        assert_eq!(rows_of::<MaskRow>(&dataset), stated);
    }
    // The text is corrected in the dataset. No export undoes that, and the next import takes the corrected text.
    let corrected = judge("cat", &[(first.id.as_str(), "The person is lying down.")]);
    assert_ne!(corrected, stated);
    for store in stores {
        export(store);
        assert_eq!(rows_of::<MaskRow>(&dataset), corrected);
        let taken: Value = annotate(&dataset, &[store, &["--json", "import"]].concat()).done();
        let counts = ["filled_tasks", "conflicts"].map(|name| taken["counts"][name].clone());
        assert_eq!(counts, [json!(1), Value::Null], "{taken}");
    }
}

#[test]
fn a_label_of_another_project_stays_when_it_is_reopened_here_or_comes_with_a_release() {
    let (dir, dataset) = dataset(12);
    let [first, second, release] =
        ["first.sqlite", "second.sqlite", "release"].map(|name| dir.path(name));
    let run = |store: &Path, words: &[&str]| -> Value {
        typed_with("annotate {} --store {} --json", &[&dataset, &store], words).done()
    };
    let of_people = || {
        let rows = rows_of::<MaskRow>(&dataset).into_iter();
        Vec::from_iter(rows.filter(|row| row.text_origin == "human"))
    };
    let stores = [&first, &second].map(|file| opened(file));
    run(&first, &["import"]);
    accept(&stores[0], people(&stores[0]), masks("testing"));
    run(&first, &["export"]);
    let stated = of_people();
    assert_eq!(stated.len(), 2, "{stated:?}");
    run(
        &first,
        &["export", "--format", "stance", "--to", arg(&release)],
    );

    // Without the table, a release names no authors, and takes nothing from the labels of the dataset.
    std::fs::remove_file(release.join("annotations.parquet")).expect("removed");
    run(&second, &["import"]);
    let taken = run(&second, &["import", arg(&release)]);
    assert_eq!(taken["counts"]["filled_tasks"], 0, "{taken}");
    assert_eq!(
        run(&second, &["export"])["counts"]["labels_left_as_they_are"],
        1
    );
    assert_eq!(of_people(), stated);

    // The second project writes a label of its own, and then reopens that of the first.
    let is_accepted = |id: &i64| {
        let task = stores[1].task_record(*id);
        task.is_ok_and(|task| task.state == TaskState::Accepted)
    };
    let label = (1..400).find(is_accepted).expect("a label");
    let (ann, eve) = people(&stores[1]);
    accept(&stores[1], (ann, eve), masks("waving"));
    run(&second, &["export"]);
    let reopen = json!({ "idem_key": "reopen-label", "task": label, "lease_epoch": 0,
        "decision": "reopen", "comment": "look again" });
    stores[1]
        .review(eve, from_json(reopen), 0)
        .expect("reopens");
    let done = run(&second, &["export"]);
    assert_eq!(
        done["counts"]["taken_back_but_kept"],
        stated.len(),
        "{done}"
    );
    let now = of_people();
    assert!(stated.iter().all(|row| now.contains(row)), "{now:?}");
}

#[test]
fn an_export_fills_a_new_store_of_the_dataset_and_comes_out_equal() {
    let (dir, dataset) = dataset(24);
    let file = |name: &str| dir.path(name);
    let run = |store: &str, words: &[&str]| -> Value {
        let store = file(store);
        typed_with("annotate {} --store {} --json", &[&dataset, &store], words).done()
    };
    for name in ["first.sqlite", "second.sqlite"] {
        opened(&file(name));
    }
    let tasks = run("first.sqlite", &["import"])["counts"]["new_tasks"].clone();
    answer_and_accept(&file("first.sqlite"));
    let export = |store: &str, format: &str, to: &str| {
        let to = file(to);
        run(store, &["export", "--format", format, "--to", arg(&to)])
    };
    let done = export("first.sqlite", "parquet", "parquet1");
    assert_eq!(done["counts"]["accepted_by own"], 2, "{done}");
    export("first.sqlite", "stance", "stance1");
    // The tasks are created before the files are imported, as a server does at its first start.
    let again = run("second.sqlite", &["import"]);
    assert_eq!(again["counts"]["new_tasks"], tasks);
    let filled = run("second.sqlite", &["import", arg(&file("stance1"))]);
    for (name, count) in [("filled_tasks", 8), ("new_tasks", 0), ("conflicts", 0)] {
        assert_eq!(filled["counts"][name], count, "{filled}");
    }
    let done = export("second.sqlite", "stance", "stance2");
    assert_eq!(done["counts"]["accepted_by import:own"], 2, "{done}");
    for list in ["pairs", "mask_all", "part_annotations", "accepted_by"] {
        let read = |folder: &str| std::fs::read(file(folder).join(format!("{list}.json")));
        let [first, second] = ["stance1", "stance2"].map(|folder| read(folder).expect("a file"));
        assert!(first == second, "{list} differs");
    }
    // Every layout marks answers that a reviewer wrote and accepted.
    let marked = |marks: Vec<Option<String>>| {
        let of = |basis: &str| marks.iter().flatten().filter(|mark| *mark == basis).count();
        [of("own"), of("review")]
    };
    let rows = read_rows::<AnnotationRow>(&file("parquet1").join("annotations.parquet"));
    let said = rows.expect("rows").into_iter().map(|row| row.accepted_by);
    assert_eq!(marked(said.collect()), [3, 9], "masks have two rows each");
    let json = |name: &str| -> Value { json_of(file("stance2").join(name)) };
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let masks = json("accepted_by.json");
    let said = masks.as_object().expect("an object").values().map(text);
    assert_eq!(marked(said.collect()), [1, 3]);
    let pairs = json("pairs.json");
    let said = list_of(&pairs).iter();
    let said = said.map(|pair| text(&pair["accepted_by"]));
    assert_eq!(marked(said.collect()), [1, 3]);
    // A store filled from the dataset itself writes the same tables.
    run("first.sqlite", &["export"]);
    let said = rows_of::<MaskRow>(&dataset).into_iter();
    assert_eq!(marked(said.map(|row| row.accepted_by).collect()), [2, 6]);
    let said = rows_of::<PairRow>(&dataset).into_iter();
    assert_eq!(marked(said.map(|row| row.accepted_by).collect()), [1, 3]);
    let tables = |name: &str| -> Value {
        let folder = Dataset::open(&dataset).expect("a dataset");
        let files = folder.manifest().tables[name].iter();
        files.map(|file| json!(file.blake3)).collect()
    };
    let before = (tables("masks"), tables("pairs"));
    dir.run("verify @dataset");
    dir.run("triplets stats @dataset --count 8 --json");
    run("third.sqlite", &["import"]);
    run("third.sqlite", &["export"]);
    assert_eq!((tables("masks"), tables("pairs")), before);
    for store in ["first.sqlite", "second.sqlite", "third.sqlite"] {
        assert_eq!(run(store, &["check"])["findings"], json!([]));
    }
    // Answers about a clip that leaves the dataset stay in the project, and do not come back with an export.
    let mut described = rows_of::<MaskRow>(&dataset).into_iter();
    let gone = described.find(|row| row.text_origin == "human");
    let gone = gone.expect("a mask of a person").motion_id;
    let line = format!("dataset remove @dataset --drop-labels --where \"id = '{gone}'\"");
    dir.run(&line);
    let done = run("first.sqlite", &["export"]);
    assert_eq!(done["counts"]["clips_gone"], 1, "{done}");
    assert_has(&done["messages"].to_string(), &[gone.as_str()]);
    let masks = rows_of::<MaskRow>(&dataset);
    assert!(masks.iter().all(|row| row.motion_id != gone));
    dir.run("verify @dataset");
}
