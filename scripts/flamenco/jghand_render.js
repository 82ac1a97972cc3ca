// SPDX-License-Identifier: MIT
//
// A job type for Flamenco 3 (https://flamenco.blender.org): renders hands with JGHand, in as many tasks as there are
// parts. docs/SCALE.md says how it is installed and used; tests/flamenco runs the commands that it emits.
//
// What is rendered is either
//   a motion     each task is a shard of `jghand render --shard 3/8 --skip-existing`: every task knows the whole motion,
//                so that the camera, motion blur and the numbers of the files are those of one run;
//   a .blend     each task is some frames of `blender --command jghand render`, whose files are named by their frame.
// Both leave pictures that are there already as they are: a task that is run again goes on.
//
// Variables of the manager (flamenco-manager.yaml): {jghand}, the command of JGHand's engine, and {blender}.

const JOB_TYPE = {
    label: "JGHand Render",
    description: "Render hands with JGHand: a motion as shards, or the frames of a .blend file",
    settings: [
        { key: "source", type: "string", required: true, default: "blend file",
          choices: ["blend file", "motion"], description: "What is rendered" },
        { key: "frames", type: "string", required: true,
          eval: "f'{C.scene.frame_start}-{C.scene.frame_end}'",
          evalInfo: { showLinkButton: true, description: "Scene frame range" },
          description: "Of a .blend file such as '47', '1-30', '3, 5-10'; of a motion '0-2399' or '0-2399:2', counted from 0" },
        { key: "chunk_size", type: "int32", default: 50, propargs: { min: 1 }, visible: "submission",
          description: "Frames of one task. Starting a task takes some seconds" },
        { key: "render_output_path", type: "string", subtype: "dir_path", required: true,
          description: "Folder of the pictures, which all workers reach under this name" },
        { key: "preset", type: "string", default: "default",
          choices: ["default", "draft", "viewport", "final", "reference"],
          description: "Accuracy against time. default: what the .blend file says; final for a motion" },
        { key: "avatar", type: "string", subtype: "file_path", default: "",
          description: "A .jghand file, builtin or painted. Empty: that of the .blend file, or builtin" },

        // of a motion
        { key: "motion", type: "string", subtype: "file_path", default: "",
          description: "Of a motion: the file, which all workers reach under this name" },
        { key: "options", type: "string", default: "", visible: "submission",
          description: "Further options of the command, such as --order mediapipe --hand right --size 1024x1024" },
        { key: "video", type: "bool", default: false, visible: "submission",
          description: "Of a motion: when all pictures are there, make a video beside them" },

        // of a .blend file
        { key: "blendfile", type: "string", required: false, visible: "web", description: "The .blend file" },
        { key: "allow_scripts", type: "bool", default: false, visible: "submission",
          description: "Let the .blend file run the Python scripts inside it" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    if (!settings.render_output_path) throw "JGHand Render: there is no folder for the pictures.";
    if (!(settings.chunk_size >= 1)) throw "JGHand Render: a task has 1 frame or more.";
    if (settings.source === "motion") {
        compileMotion(job, settings);
    } else {
        compileBlendFile(job, settings);
    }
}

// ---- a motion ---------------------------------------------------------------------------------------------------------

function compileMotion(job, settings) {
    if (!settings.motion) throw "JGHand Render: there is no motion.";
    const words = ["render", "--motion", settings.motion, "--frames", settings.frames.trim(),
        "--out", settings.render_output_path, ...commonWords(settings), "--skip-existing"];

    const count = Math.ceil(countFrames(settings.frames) / settings.chunk_size);
    if (count > 9999) throw `JGHand Render: ${count} tasks are too many; take more frames in each.`;
    const shards = [];
    for (let number = 1; number <= count; number++) {
        const task = author.Task(`shard-${number}-of-${count}`, "misc");
        task.addCommand(author.Command("exec", {
            exe: "{jghand}", args: words.concat(["--shard", `${number}/${count}`]),
        }));
        shards.push(task);
    }
    for (const task of shards) job.addTask(task);
    if (settings.video) {
        const task = author.Task("video", "misc");
        task.addCommand(author.Command("exec", {
            exe: "{jghand}", args: words.concat(["--video", path.join(settings.render_output_path, "video.mp4")]),
        }));
        for (const shard of shards) task.addDependency(shard);
        job.addTask(task);
    }
}

// How many frames `jghand render --frames` takes.
function countFrames(text) {
    const match = /^\s*(\d+)(?:[-:](\d+)(?::(\d+))?)?\s*$/.exec(text);
    if (!match) throw `JGHand Render: frames of a motion are FIRST-LAST or FIRST-LAST:STEP, not '${text}'.`;
    const first = parseInt(match[1]);
    const last = match[2] === undefined ? first : parseInt(match[2]);
    const step = match[3] === undefined ? 1 : parseInt(match[3]);
    if (last < first || step < 1) throw `JGHand Render: there are no frames in '${text}'.`;
    return Math.floor((last - first) / step) + 1;
}

// ---- a .blend file ----------------------------------------------------------------------------------------------------

function compileBlendFile(job, settings) {
    if (!settings.blendfile) throw "JGHand Render: there is no .blend file.";
    const words = ["--command", "jghand", "render", settings.blendfile,
        "--out", settings.render_output_path, ...commonWords(settings)];
    if (settings.allow_scripts) words.push("--allow-scripts");
    for (const chunk of frameChunker(settings.frames, settings.chunk_size)) {
        const task = author.Task(`render-${chunk}`, "blender");
        for (const run of runsOf(chunk)) {
            task.addCommand(author.Command("exec", { exe: "{blender}", args: words.concat(["--frames", run]) }));
        }
        job.addTask(task);
    }
}

// Flamenco's '1,2,5-9' as '1-2' and '5-9': to the command a comma is a step.
function runsOf(chunk) {
    const runs = [];
    for (const part of chunk.split(",")) {
        const ends = part.split("-").map((text) => parseInt(text));
        const first = ends[0], last = ends[ends.length - 1];
        const run = runs[runs.length - 1];
        if (run && run[1] + 1 === first) {
            run[1] = last;
        } else {
            runs.push([first, last]);
        }
    }
    return runs.map(([first, last]) => first === last ? `${first}` : `${first}-${last}`);
}

// ---- both -------------------------------------------------------------------------------------------------------------

function commonWords(settings) {
    const words = [];
    if (settings.preset && settings.preset !== "default") words.push("--preset", settings.preset);
    if (settings.avatar) words.push("--avatar", settings.avatar);
    return words.concat(splitWords(settings.options || ""));
}

// Words between spaces; quotes keep spaces inside.
function splitWords(text) {
    const words = [];
    const pattern = /"([^"]*)"|'([^']*)'|(\S+)/g;
    for (let match = pattern.exec(text); match; match = pattern.exec(text)) {
        words.push(match[1] !== undefined ? match[1] : match[2] !== undefined ? match[2] : match[3]);
    }
    return words;
}
