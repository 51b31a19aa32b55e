// One view for a live stream and for a report; which of the two, the page's own data says.

import { type LiveConfig, openLive } from "./live";
import { openReport } from "./report";

const text = (id: string) => document.getElementById(id)?.textContent ?? null;

const live = text("live");
if (live !== null) openLive(JSON.parse(live) as LiveConfig);
else void openReport(text("lines") ?? "", text("film"));
