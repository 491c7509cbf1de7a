// The report of a ladder: what its trainings found, summed up, as a page, a table or JSON.
#ifndef RN_SERVER_REPORT_REPORT_H
#define RN_SERVER_REPORT_REPORT_H

#include "common/base/buf.h"
#include "proto/ladder.h"

// Sums up what is there; takes the record, which is the report's from here on (also on failure).
// rn_message_finish(&rn_ladder_report_table, ...) frees it.
enum rn_status rn_report_make(struct rn_ladder_record *record, struct rn_ladder_report *ret_report,
                              struct rn_error *err) RN_MUST_CHECK;
// The published figures of the scene of that benchmark that a dataset is named after; NULL: none.
size_t rn_report_paper(const char *dataset_name, const struct rn_paper_figure **ret_figures);

// One line for each moment and end of a training.
void rn_report_csv(const struct rn_ladder_report *report, struct rn_buf *out);
// A page that needs nothing beside it, the CSV and the JSON within.
void rn_report_html(const struct rn_ladder_report *report, const char *json, struct rn_buf *out);

#endif
