/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/split.h"

#include <opencv2/imgproc.hpp>

#include <new>
#include <vector>

void gsn_components_free(struct gsn_components *pieces)
{
    if (!pieces)
        return;
    gsn_free(pieces->piece);
    gsn_free(pieces->label);
    gsn_free(pieces);
}

static void close_gaps(cv::Mat &mask, int cells)
{
    const cv::Size size(2 * cells + 1, 2 * cells + 1);
    const cv::Mat disc = cv::getStructuringElement(cv::MORPH_ELLIPSE, size);
    cv::Mat framed;

    /* In a frame, or the closing would grow things along the border of the picture. */
    cv::copyMakeBorder(mask, framed, cells, cells, cells, cells, cv::BORDER_CONSTANT, 0);
    cv::morphologyEx(framed, framed, cv::MORPH_CLOSE, disc);
    framed(cv::Rect(cells, cells, mask.cols, mask.rows)).copyTo(mask);
}

static gsn_component piece_of(const cv::Mat &stats, const cv::Mat &centres, int label)
{
    gsn_component piece = {};

    piece.x = stats.at<int>(label, cv::CC_STAT_LEFT);
    piece.y = stats.at<int>(label, cv::CC_STAT_TOP);
    piece.width = stats.at<int>(label, cv::CC_STAT_WIDTH);
    piece.height = stats.at<int>(label, cv::CC_STAT_HEIGHT);
    piece.area = static_cast<size_t>(stats.at<int>(label, cv::CC_STAT_AREA));
    piece.cx = centres.at<double>(label, 0) + 0.5;
    piece.cy = centres.at<double>(label, 1) + 0.5;
    return piece;
}

/* OpenCV's numbers depend on how many threads it used; ours go by the first cell from the top. */
static void fill(gsn_components &pieces, const cv::Mat &labels, const cv::Mat &stats,
                 const cv::Mat &centres)
{
    std::vector<int32_t> number(pieces.count + 1);
    int32_t next = 0;

    for (size_t i = 0; i < labels.total(); i++) {
        const int label = labels.ptr<int>()[i];

        if (label > 0 && number[static_cast<size_t>(label)] == 0) {
            pieces.piece[next] = piece_of(stats, centres, label);
            number[static_cast<size_t>(label)] = ++next;
        }
        pieces.label[i] = number[static_cast<size_t>(label)];
    }
}

int gsn_split_pieces(uint8_t *mask, int width, int height, int close_cells,
                     struct gsn_components **ret_pieces, struct gsn_error *err)
try {
    cv::Mat picture(height, width, CV_8U, mask), labels, stats, centres;
    gsn_auto(gsn_components) pieces = nullptr;
    int count;

    if (close_cells > 0)
        close_gaps(picture, close_cells);
    count = cv::connectedComponentsWithStats(picture, labels, stats, centres, 8, CV_32S);

    pieces = static_cast<gsn_components *>(gsn_alloc_array(1, sizeof *pieces));
    if (!pieces)
        throw std::bad_alloc();
    pieces->count = static_cast<size_t>(count - 1);
    pieces->piece =
        static_cast<gsn_component *>(gsn_alloc_array(pieces->count, sizeof *pieces->piece));
    pieces->label = static_cast<int32_t *>(gsn_alloc_array(labels.total(), sizeof *pieces->label));
    if (!pieces->piece || !pieces->label)
        throw std::bad_alloc();
    fill(*pieces, labels, stats, centres);

    *ret_pieces = gsn_steal(&pieces);
    return GSN_OK;
} catch (const std::bad_alloc &) {
    return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
} catch (const cv::Exception &e) {
    return e.code == cv::Error::StsNoMem
               ? gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel")
               : gsn_fail(err, GSN_E_INPUT, "the panel cannot be split: %s", e.err.c_str());
} catch (...) {
    return gsn_fail(err, GSN_E_INPUT, "the panel cannot be split");
}
