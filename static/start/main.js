// The start page: what is kept on the server, and how a new session is made.

import { byId } from "../session/dom.js";
import { fillForm } from "./new_session.js";
import { showEntries } from "./recordings.js";
import { offerSamples } from "./samples.js";
import { follow } from "./sessions.js";
import { refresh } from "./stored.js";
import { takeFiles } from "./upload.js";

for (const place of document.querySelectorAll(".here")) place.textContent = location.origin;
// From the title to the form, which lies below the list on a narrow screen: the keyboard's focus goes along.
document.querySelector(".wanted").addEventListener("click", () => byId("new").focus({ preventScroll: true }));

showEntries();
fillForm();
takeFiles();
follow();
offerSamples();
refresh();
