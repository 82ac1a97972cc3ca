// Stands in for Flamenco's manager: gives a job compiler script what its JavaScript engine gives it, and prints what
// the script makes of a job. node manager.js SCRIPT SETTINGS.json
"use strict";

const fs = require("fs");
const posix = require("path").posix;
const vm = require("vm");

class Task {
    constructor(name, type) {
        Object.assign(this, { name, type, commands: [], dependencies: [] });
    }

    addCommand(command) {
        this.commands.push(command);
    }

    addDependency(task) {
        this.dependencies.push(task.name);
    }
}

// Ranges such as "1-10, 20..25, 40" in pieces of so many frames; two frames in a row are "1,2".
function frameChunker(text, size) {
    const frames = new Set();
    for (const part of text.replaceAll("..", "-").split(",")) {
        const ends = part.split("-").map((word) => parseInt(word.trim()));
        if (ends.some(Number.isNaN) || ends.length > 2) throw `invalid range "${text}"`;
        for (let frame = ends[0]; frame <= ends[ends.length - 1]; frame++) frames.add(frame);
    }
    const sorted = [...frames].sort((a, b) => a - b);
    const chunks = [];
    for (let at = 0; at < sorted.length; at += size) chunks.push(merged(sorted.slice(at, at + size)));
    return chunks;
}

function merged(frames) {
    const parts = [];
    for (let at = 0; at < frames.length; ) {
        let end = at;
        while (end + 1 < frames.length && frames[end + 1] === frames[end] + 1) end++;
        if (end - at < 2) {
            parts.push(...frames.slice(at, end + 1));
        } else {
            parts.push(`${frames[at]}-${frames[end]}`);
        }
        at = end + 1;
    }
    return parts.join(",");
}

const [script, settings] = process.argv.slice(2);
const context = vm.createContext({
    author: { Task: (name, type) => new Task(name, type), Command: (name, parameters) => ({ name, parameters }) },
    path: { basename: posix.basename, dirname: posix.dirname, join: posix.join, stem: (file) => posix.parse(file).name },
    frameChunker,
    print: () => undefined,
    alert: () => undefined,
    formatTimestampLocal: () => "2026-01-01_000000",
});
const source = fs.readFileSync(script, "utf-8");
vm.runInContext(`${source}\nthis.jobType = JOB_TYPE; this.compile = compileJob;`, context);

// as the manager does: what is not given has its default
const given = JSON.parse(fs.readFileSync(settings, "utf-8"));
const job = { name: "test", settings: {}, tasks: [], addTask: (task) => job.tasks.push(task) };
for (const setting of context.jobType.settings) {
    const value = setting.key in given ? given[setting.key] : setting.default;
    if (value !== undefined) job.settings[setting.key] = value;
}
try {
    context.compile(job);
    console.log(JSON.stringify({ jobType: context.jobType, tasks: job.tasks }));
} catch (error) {
    console.error(String(error));
    process.exitCode = 1;
}
