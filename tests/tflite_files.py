"""Small TensorFlow Lite files, written by the format's own builders."""

import flatbuffers
import numpy as np
import tflite


def tflite_file(layers):
    """Bytes of a network of convolutions.

    Args:
        layers: (kernel (outputs, inputs / groups, rows, columns), bias) of each, numpy; one input per group makes it
            depthwise. (slopes,) is a leaky ReLU, (weights (outputs, inputs), bias, name) a fully connected layer.
            float16 ones are widened by a node of their own before they are used, as published files do.
    """
    builder = flatbuffers.Builder(1 << 20)
    kinds = [
        tflite.BuiltinOperator.DEQUANTIZE,
        tflite.BuiltinOperator.CONV_2D,
        tflite.BuiltinOperator.DEPTHWISE_CONV_2D,
        tflite.BuiltinOperator.PRELU,
        tflite.BuiltinOperator.FULLY_CONNECTED,
    ]
    buffers, tensors, nodes = [empty_buffer(builder)], [], []

    def tensor(values=None, *, shape=(1,), name=""):
        number, called = 0, builder.CreateString(name)
        if values is not None:
            number, shape = len(buffers), values.shape
            data = builder.CreateByteVector(np.ascontiguousarray(values).tobytes())
            tflite.BufferStart(builder)
            tflite.BufferAddData(builder, data)
            buffers.append(tflite.BufferEnd(builder))
        dimensions = builder.CreateNumpyVector(np.asarray(shape, np.int32))
        half = values is not None and values.dtype == np.float16
        tflite.TensorStart(builder)
        tflite.TensorAddShape(builder, dimensions)
        tflite.TensorAddType(builder, tflite.TensorType.FLOAT16 if half else tflite.TensorType.FLOAT32)
        tflite.TensorAddBuffer(builder, number)
        tflite.TensorAddName(builder, called)
        tensors.append(tflite.TensorEnd(builder))
        if half:
            widened = tensor(shape=shape, name=f"{name}_dequantize")
            node(tflite.BuiltinOperator.DEQUANTIZE, [widened - 1], widened)
            return widened
        return len(tensors) - 1

    def node(kind, inputs, output):
        given = builder.CreateNumpyVector(np.asarray(inputs, np.int32))
        made = builder.CreateNumpyVector(np.asarray([output], np.int32))
        tflite.OperatorStart(builder)
        tflite.OperatorAddOpcodeIndex(builder, kinds.index(kind))
        tflite.OperatorAddInputs(builder, given)
        tflite.OperatorAddOutputs(builder, made)
        nodes.append(tflite.OperatorEnd(builder))

    value = tensor()
    for layer in layers:
        if len(layer) == 1:
            result = tensor(layer[0][None, None])
            node(tflite.BuiltinOperator.PRELU, [value, result], value := tensor())
            continue
        if len(layer) == 3:
            weights, bias, name = layer
            node(kinds[-1], [value, tensor(weights, name=f"model/{name}/MatMul"), tensor(bias)], tensor())
            continue
        kernel, bias = layer
        depthwise = kernel.shape[1] == 1
        stored = kernel.transpose(1, 2, 3, 0) if depthwise else kernel.transpose(0, 2, 3, 1)
        weights = [tensor(stored), tensor(bias)]
        result = tensor()
        kind = tflite.BuiltinOperator.DEPTHWISE_CONV_2D if depthwise else tflite.BuiltinOperator.CONV_2D
        node(kind, [value, *weights], result)
        value = result

    lists = [offsets(builder, tensors), offsets(builder, nodes)]
    tflite.SubGraphStart(builder)
    tflite.SubGraphAddTensors(builder, lists[0])
    tflite.SubGraphAddOperators(builder, lists[1])
    graphs = offsets(builder, [tflite.SubGraphEnd(builder)])
    codes = []
    for kind in kinds:
        tflite.OperatorCodeStart(builder)
        tflite.OperatorCodeAddDeprecatedBuiltinCode(builder, kind)
        codes.append(tflite.OperatorCodeEnd(builder))
    lists = [offsets(builder, codes), offsets(builder, buffers)]
    tflite.ModelStart(builder)
    tflite.ModelAddOperatorCodes(builder, lists[0])
    tflite.ModelAddSubgraphs(builder, graphs)
    tflite.ModelAddBuffers(builder, lists[1])
    builder.Finish(tflite.ModelEnd(builder), b"TFL3")
    return bytes(builder.Output())


def empty_buffer(builder):
    tflite.BufferStart(builder)
    return tflite.BufferEnd(builder)


def offsets(builder, entries):
    builder.StartVector(4, len(entries), 4)
    for entry in reversed(entries):
        builder.PrependUOffsetTRelative(entry)
    return builder.EndVector()
